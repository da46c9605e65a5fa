"""Two engines for the same fixed-noise Gaussian-process posteriors.

``spectral`` is the default: one eigendecomposition serves every prior scale.
``gpytorch`` runs a GPyTorch ``ExactGP`` for each. A test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.confidence import Moments, SampleEvidence
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.samples import OutcomeSamples

VARIANCE_ROUNDING = 1e-12
"""Tolerance: added to the posterior variance, relative to the prior's, so that rounding can only widen a bound."""


class HasEvidence(Protocol):
    """Data as a confidence set sees them, in units of R."""

    def evidence(self, scales: FloatArray) -> SampleEvidence:
        """Return log-determinants and quadratic forms for (A,) scales."""


class Conditioned(HasEvidence, Protocol):
    """The priors a·k, for any scale a, conditioned on data; everything in units of R."""

    def moments(self, scales: FloatArray, points: FloatArray) -> Moments:
        """Return posterior means and standard deviations at (G, dim) points for (A,) scales."""


class Engine(Protocol):
    """Conditions priors on samples."""

    def condition(self, points: FloatArray, samples: OutcomeSamples) -> Conditioned:
        """Condition on samples, u ≥ 1 of them, at (P, dim) points; the noise variances are 1/counts.

        ``points`` may only ever grow from one call to the next.
        """


class Spectral:
    """Eigendecomposition of M^½ K M^½ on the distinct points; no jitter is ever needed."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._rows: dict[int, FloatArray] = {}  # (P,) covariances of each point with data, each computed once

    def condition(self, points: FloatArray, samples: OutcomeSamples) -> Conditioned:
        """Condition on samples; see :class:`Engine`."""
        for place in samples.at.tolist():
            row = self._rows.get(place, np.zeros(0))
            if len(row) < len(points):
                fresh = self._kernel.gram(points[place : place + 1], points[len(row) :])[0]
                self._rows[place] = np.concatenate([row, fresh])
        cross = np.stack([self._rows[place] for place in samples.at.tolist()])
        return _Spectrum(self._kernel, samples, points, cross)


class _Spectrum:
    def __init__(
        self, kernel: Kernel, samples: OutcomeSamples, points: FloatArray, cross: FloatArray
    ) -> None:
        root = np.sqrt(samples.counts)
        eigenvalues, vectors = np.linalg.eigh(root[:, None] * cross[:, samples.at] * root)
        self._kernel, self._points, self._cross = kernel, points, cross
        self._data = points[samples.at]
        self._eigenvalues = np.clip(eigenvalues, 0, None)
        self._whiten = vectors.T * root  # (u, u)
        self._loads = self._whiten @ samples.means

    def evidence(self, scales: FloatArray) -> SampleEvidence:
        spread = 1 + scales[:, None] * self._eigenvalues
        return SampleEvidence(np.log(spread).sum(axis=1), (self._loads**2 / spread).sum(axis=1))

    def moments(self, scales: FloatArray, points: FloatArray) -> Moments:
        known = len(points) == len(self._points) and points is self._points
        cross = self._cross if known else self._kernel.gram(self._data, points)
        columns = self._whiten @ cross  # (u, G)
        a = scales[:, None]
        shrink = 1 / (1 + a * self._eigenvalues)  # (A, u)
        variance = a - a**2 * (shrink @ columns**2)
        std = np.sqrt(np.clip(variance, 0, None) + VARIANCE_ROUNDING * a)
        return Moments(a * ((shrink * self._loads) @ columns), std)


class GPyTorch:
    """ExactGPs with ZeroMean, ScaleKernel(a) and FixedNoiseGaussianLikelihood(1/counts), in float64."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel

    def condition(self, points: FloatArray, samples: OutcomeSamples) -> Conditioned:
        """Condition on samples; see :class:`Engine`."""
        return _ExactGP(self._kernel, points[samples.at], samples)


class _ExactGP:
    def __init__(self, kernel: Kernel, data: FloatArray, samples: OutcomeSamples) -> None:
        import torch

        self._kernel = kernel
        arrays = (data, samples.means, 1 / samples.counts)
        self._x, self._y, self._noise = (torch.from_numpy(np.array(array)) for array in arrays)

    def evidence(self, scales: FloatArray) -> SampleEvidence:
        import torch

        with torch.no_grad():
            root = torch.sqrt(1 / self._noise)
            gram = self._kernel.torch(self._x.shape[1])(self._x).to_dense()
            each = [torch.eye(len(root)).double() + float(a) * root[:, None] * gram * root for a in scales]
            log_det = [float(torch.logdet(matrix)) for matrix in each]
            target = root * self._y
            quadratic = [float(target @ torch.linalg.solve(matrix, target)) for matrix in each]
        return SampleEvidence(np.array(log_det), np.array(quadratic))

    def moments(self, scales: FloatArray, points: FloatArray) -> Moments:
        import gpytorch as gp
        import torch

        # A certificate depends on exact algebra: no conjugate gradients, no LOVE, no
        # rounding up of small noises (1/counts may lie below the default 1e-6).
        with (
            torch.no_grad(),
            gp.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False),
            gp.settings.max_cholesky_size(10**6),
            gp.settings.min_fixed_noise(double_value=1e-300),
            gp.settings.min_variance(double_value=1e-300),
        ):
            posteriors = [self._model(float(a))(torch.from_numpy(np.array(points))) for a in scales]
            mean = np.stack([posterior.mean.numpy() for posterior in posteriors])
            variance = np.stack([posterior.variance.numpy() for posterior in posteriors])
        std = np.sqrt(np.clip(variance, 0, None) + VARIANCE_ROUNDING * scales[:, None])
        return Moments(mean, std)

    def _model(self, scale: float) -> Any:
        import gpytorch as gp
        import torch

        x, y, kernel = self._x, self._y, self._kernel

        class FixedNoiseGP(gp.models.ExactGP):  # type: ignore[misc]
            def __init__(self, likelihood: Any) -> None:
                super().__init__(x, y, likelihood)
                self.mean_module = gp.means.ZeroMean()
                self.covar_module = gp.kernels.ScaleKernel(kernel.torch(x.shape[1])).double()
                self.covar_module.outputscale = torch.tensor(scale, dtype=torch.float64)

            def forward(self, z: Any) -> Any:
                return gp.distributions.MultivariateNormal(self.mean_module(z), self.covar_module(z))

        likelihood = gp.likelihoods.FixedNoiseGaussianLikelihood(noise=self._noise).double()
        return FixedNoiseGP(likelihood).double().eval()


ENGINES: dict[str, Callable[[Kernel], Engine]] = {"spectral": Spectral, "gpytorch": GPyTorch}
