"""Two engines for the same fixed-noise Gaussian-process posteriors.

``spectral`` is the default: one eigendecomposition serves every prior scale.
``gpytorch`` runs a GPyTorch ``ExactGP`` for each. A test holds them to each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from s2r_spec.certify.confidence import Posterior
from s2r_spec.certify.kernels import Kernel

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

# Added to the posterior variance, relative to the prior's, so that rounding can only widen a bound.
VARIANCE_ROUNDING = 1e-12


class Engine(Protocol):
    """Posteriors at a grid from data at some of the grid's points."""

    def posterior(
        self, at: IndexArray, counts: FloatArray, means: FloatArray, scales: FloatArray
    ) -> Posterior:
        """Condition the priors a·k on data, in units of R.

        Args:
            at: (u,) distinct grid indices, u ≥ 1.
            counts: (u,) rollouts per point; the noise variances are 1/counts.
            means: (u,) mean outcomes.
            scales: (A,) prior variances a.
        """
        ...


class Spectral:
    """Eigendecomposition of M^½ K M^½ on the distinct points; no jitter is ever needed."""

    def __init__(self, kernel: Kernel, grid: FloatArray) -> None:
        self._kernel, self._grid = kernel, grid
        self._rows: dict[int, FloatArray] = {}

    def posterior(
        self, at: IndexArray, counts: FloatArray, means: FloatArray, scales: FloatArray
    ) -> Posterior:
        """Condition on data; see :class:`Engine`."""
        cross, root, a = self._cross(at), np.sqrt(counts), scales[:, None]
        eigenvalues, vectors = np.linalg.eigh(root[:, None] * cross[:, at] * root)
        eigenvalues = np.clip(eigenvalues, 0, None)
        loads = vectors.T @ (root * means)  # (u,)
        columns = vectors.T @ (root[:, None] * cross)  # (u, G)
        shrink = 1 / (1 + a * eigenvalues)  # (A, u)
        variance = a - a**2 * (shrink @ columns**2)
        return Posterior(
            mean=a * ((shrink * loads) @ columns),
            std=np.sqrt(np.clip(variance, 0, None) + VARIANCE_ROUNDING * a),
            log_det=-np.log(shrink).sum(axis=1),
            quadratic=shrink @ loads**2,
        )

    def _cross(self, at: IndexArray) -> FloatArray:
        """Return (u, G) covariances k with the whole grid; each row is computed once."""
        for place in at.tolist():
            if place not in self._rows:
                self._rows[place] = self._kernel.gram(self._grid[place : place + 1], self._grid)[0]
        return np.stack([self._rows[place] for place in at.tolist()])


class GPyTorch:
    """ExactGPs with ZeroMean, ScaleKernel(a) and FixedNoiseGaussianLikelihood(1/counts), in float64."""

    def __init__(self, kernel: Kernel, grid: FloatArray) -> None:
        self._kernel, self._grid = kernel, grid

    def posterior(
        self, at: IndexArray, counts: FloatArray, means: FloatArray, scales: FloatArray
    ) -> Posterior:
        """Condition on data; see :class:`Engine`."""
        each = [self._one(at, counts, means, float(a)) for a in scales]
        mean, std, log_det, quadratic = (np.array(column) for column in zip(*each, strict=True))
        return Posterior(mean, std, log_det, quadratic)

    def _one(
        self, at: IndexArray, counts: FloatArray, means: FloatArray, scale: float
    ) -> tuple[FloatArray, FloatArray, float, float]:
        import gpytorch as gp
        import torch

        kernel = self._kernel
        x, y, noise, grid = (
            torch.from_numpy(np.array(a)) for a in (self._grid[at], means, 1 / counts, self._grid)
        )

        class FixedNoiseGP(gp.models.ExactGP):  # type: ignore[misc]
            def __init__(self, likelihood: Any) -> None:
                super().__init__(x, y, likelihood)
                self.mean_module = gp.means.ZeroMean()
                self.covar_module = gp.kernels.ScaleKernel(kernel.torch(x.shape[1])).double()
                self.covar_module.outputscale = torch.tensor(scale, dtype=torch.float64)

            def forward(self, z: Any) -> Any:
                return gp.distributions.MultivariateNormal(self.mean_module(z), self.covar_module(z))

        # A certificate depends on exact algebra: no conjugate gradients, no LOVE, no
        # rounding up of small noises (1/counts may lie below the default 1e-6).
        with (
            torch.no_grad(),
            gp.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False),
            gp.settings.max_cholesky_size(10**6),
            gp.settings.min_fixed_noise(double_value=1e-300),
            gp.settings.min_variance(double_value=1e-300),
        ):
            likelihood = gp.likelihoods.FixedNoiseGaussianLikelihood(noise=noise).double()
            model = FixedNoiseGP(likelihood).double().eval()
            posterior = model(grid)
            root = torch.sqrt(1 / noise)
            gram = model.covar_module(x).to_dense()
            whitened = torch.eye(len(root), dtype=torch.float64) + root[:, None] * gram * root
            variance = np.clip(posterior.variance.numpy(), 0, None)
            return (
                posterior.mean.numpy(),
                np.sqrt(variance + VARIANCE_ROUNDING * scale),
                float(torch.logdet(whitened)),
                float((root * y) @ torch.linalg.solve(whitened, root * y)),
            )


ENGINES: dict[str, Callable[[Kernel, FloatArray], Engine]] = {"spectral": Spectral, "gpytorch": GPyTorch}
