"""A Gaussian process, averaged over its size and its length scales.

Data: noisy values (n,) of a function of the unit cube, with standard errors (n,). Unknown: the function. Model: a
constant plus a process with a Matérn-5/2 covariance; its size and its length scales have log-normal priors. Estimator:
draws from these priors, weighted with the marginal likelihood of the data. With ten tests, one best length scale would
give too narrow a band.

Units: those of the values. Shapes: n places of data, m places of a grid, b draws of size and length scales. Source:
Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006, eqs 2.25, 2.26, 2.30 and §5.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

KEPT = 32
"""Budget: pairs of size and length scales that remain, of eight times as many draws from their prior, after resampling
by weight. Doubled, their average is more exact, and sampling functions takes up to twice as long."""
PRIOR = ((1.0, 0.7), (0.4, 0.8))
"""Prior: median and standard deviation of the logarithm, of the size over the test space in parts of the data's
standard deviation, and of a length scale in parts of an axis. A doubled median of the size gives wider bands far from
the tests; one of the length scale expects a smoother gap."""


def functions(
    at: FloatArray,
    values: FloatArray,
    errors: FloatArray,
    grid: FloatArray,
    count: int,
    generator: np.random.Generator,
) -> tuple[FloatArray, float]:
    """Return (count, m) functions from the posterior, and the log evidence of the process.

    Args:
        at: (n, dim) places of the data.
        values: (n,).
        errors: (n,) standard errors.
        grid: (m, dim) places of the functions.
        count: number of functions.
        generator: of random numbers.
    """
    from scipy.stats import norm, qmc

    level = float(values.mean())
    # Without any spread in the data, their errors give the scale.
    scale = float(values.std()) or float(errors.max()) or 1.0
    scaled, noise = (values - level) / scale, np.diag(np.maximum(np.square(errors / scale), 1e-6))
    # Draws are spread evenly over the prior.
    even = qmc.Sobol(1 + at.shape[1], rng=np.random.default_rng(0)).random(8 * KEPT)
    medians, spreads = np.array([PRIOR[0]] + [PRIOR[1]] * at.shape[1]).T
    drawn: FloatArray = medians * np.exp(spreads * norm.ppf(np.clip(even, 1e-6, 1 - 1e-6)))
    sizes, lengths = drawn[:, 0], drawn[:, 1:]
    roots = np.linalg.cholesky(
        [_covariance(*one, at, at) + noise for one in zip(sizes, lengths, strict=True)]
    )
    white = np.linalg.solve(roots, scaled[:, None])[..., 0]
    log = -np.square(white).sum(axis=1) / 2 - np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    weights = np.exp(log - log.max())
    sums = np.cumsum(weights)
    picked = np.searchsorted(sums / sums[-1], (np.arange(KEPT) + generator.uniform()) / KEPT)
    sampled = []
    for k, times in zip(*np.unique(picked[np.arange(count) % KEPT], return_counts=True), strict=True):
        across = np.linalg.solve(roots[k], _covariance(sizes[k], lengths[k], at, grid))
        left = _covariance(sizes[k], lengths[k], grid, grid) - across.T @ across
        left[np.diag_indices_from(left)] += 1e-6 * (1.0 + sizes[k] ** 2)
        normal = generator.standard_normal((times, len(grid)))
        sampled.append(white[k] @ across + normal @ np.linalg.cholesky(left).T)
    evidence = float(np.log(weights.mean()) + log.max()) - len(values) * float(np.log(scale))
    return level + scale * np.concatenate(sampled), evidence


def _covariance(size: float, lengths: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    """Return (n, m) covariance of (n, dim) and (m, dim) places: Matérn-5/2, plus 1 for the constant."""
    far = np.sqrt(5.0 * np.square((left[:, None] - right) / lengths).sum(axis=-1))
    shape: FloatArray = 1.0 + size**2 * (1.0 + far + np.square(far) / 3.0) * np.exp(-far)
    return shape
