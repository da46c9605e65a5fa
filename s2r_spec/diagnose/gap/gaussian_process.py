"""A Gaussian process, averaged over its size and its length scales.

Data: noisy values (n,) of a function of the unit cube. Unknown: the function. Model: a constant plus a process with a
Matérn-5/2 covariance; its size and its length scales have log-normal priors. Estimator: draws from these priors,
weighted with the marginal likelihood of the data. With ten tests, one best length scale would give too narrow a band.

Units: those of the values. Source: Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006, eqs 2.25,
2.26, 2.30 and §5.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DRAWS = 256
"""Budget: draws of size and length scales from their prior. Doubled, their average is more exact."""
_LENGTH = (0.4, 0.8)
"""Prior: median of a length scale, as a part of the axis, and standard deviation of its logarithm. A doubled median
expects a smoother gap."""
_SIZE = (1.0, 0.7)
"""Prior: the same of the standard deviation over the test space, as a part of that of the data. A doubled median gives
wider bands far from the tests."""
_KEPT = DRAWS // 8
"""Budget: draws that remain after resampling by weight. Doubled, sampling functions takes up to twice as long."""


@dataclass(frozen=True, eq=False)
class Data:
    """Noisy values of a function of the unit cube.

    Args:
        at: (n, dim) places.
        values: (n,).
        deviations: (n,) standard errors.
    """

    at: FloatArray
    values: FloatArray
    deviations: FloatArray


def functions(
    data: Data, grid: FloatArray, count: int, generator: np.random.Generator
) -> tuple[FloatArray, float]:
    """Return (count, m) functions from the posterior, on (m, dim) places, and the log evidence of the process."""
    level = float(data.values.mean())
    # without any spread in the data, their errors give the scale
    scale = float(data.values.std()) or float(data.deviations.max()) or 1.0
    values = (data.values - level) / scale
    noise = np.diag(np.maximum(np.square(data.deviations / scale), 1e-6))
    sizes, lengths = _prior(data.at.shape[1])
    roots = np.linalg.cholesky(_covariance(sizes, lengths, data.at, data.at) + noise)
    white = np.linalg.solve(roots, values[:, None])[..., 0]
    log = -np.square(white).sum(axis=1) / 2 - np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    weights = np.cumsum(np.exp(log - log.max()))
    picked = np.searchsorted(weights / weights[-1], (np.arange(_KEPT) + generator.uniform()) / _KEPT)
    counts = np.bincount(picked[np.arange(count) % _KEPT], minlength=DRAWS)
    sampled = []
    for k in np.flatnonzero(counts):
        one = slice(k, k + 1)
        across = np.linalg.solve(roots[k], _covariance(sizes[one], lengths[one], data.at, grid)[0])
        left = _covariance(sizes[one], lengths[one], grid, grid)[0] - across.T @ across
        left[np.diag_indices_from(left)] += 1e-6 * (1.0 + sizes[k] ** 2)
        normal = generator.standard_normal((counts[k], len(grid)))
        sampled.append(white[k] @ across + normal @ np.linalg.cholesky(left).T)
    evidence = float(np.log(np.exp(log - log.max()).mean()) + log.max()) - len(values) * float(np.log(scale))
    return level + scale * np.concatenate(sampled), evidence


def _prior(dim: int) -> tuple[FloatArray, FloatArray]:
    """Return (DRAWS,) sizes and (DRAWS, dim) length scales, spread evenly over their prior."""
    from scipy.stats import norm, qmc

    even = qmc.Sobol(1 + dim, rng=np.random.default_rng(0)).random(DRAWS)
    medians, spreads = np.array([_SIZE] + [_LENGTH] * dim).T
    spread: FloatArray = medians * np.exp(spreads * norm.ppf(np.clip(even, 1e-6, 1 - 1e-6)))
    return spread[:, 0], spread[:, 1:]


def _covariance(sizes: FloatArray, lengths: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    """Return (b, n, m) covariance: Matérn-5/2, plus 1 for the constant."""
    steps = (left[:, None] - right)[None] / lengths[:, None, None]
    far = np.sqrt(5.0 * np.square(steps).sum(axis=-1))
    shape: FloatArray = 1.0 + sizes[:, None, None] ** 2 * (1.0 + far + np.square(far) / 3.0) * np.exp(-far)
    return shape
