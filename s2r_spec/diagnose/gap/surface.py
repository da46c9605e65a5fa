"""The gap over the test space, from a Gaussian process.

Data: Δρ (n,) at the tests that were run, with standard errors from replicates. Unknown: the signed gap g(x) = E Δρ at
every test x. Model: g is a constant plus a process with a Matérn-5/2 covariance, whose size and length scales have
log-normal priors; or the prediction of an improved simulator plus such a process. Both models have a weight in
proportion to their evidence. Estimator: functions that are sampled from the posterior, for draws of size and length
scales that are weighted with the marginal likelihood: with ten tests, one best length scale would give too narrow a
band. E|Δρ| follows from g and the scatter, as the mean of a folded normal distribution.

Units: those of ρ; places in the unit cube. Shapes: n tests, m places of a grid over the space, DRAWS functions. Source:
Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006, eqs 2.25, 2.26, 2.30 and §5.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_types import Probability
from s2r_spec.base.json_values import Ends, Shown
from s2r_spec.diagnose.gap import DRAWS, LEVEL
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest, mean_difference
from s2r_spec.space import Space

COUNTS = {1: 101, 2: 21, 3: 7, 4: 5}
"""Definition: places along each axis of a space of so many parameters; over five, a grid would have too few."""
MOST_PREDICTED = 0.75
"""Prior: largest weight of the improved simulator, because it was fitted to the same rollouts. At 1, it may be
alone."""
KEPT = 32
"""Budget: pairs of size and length scales that remain, of eight times as many draws from their prior, after resampling
by weight."""
PRIOR = ((1.0, 0.7), (0.4, 0.8))
"""Prior: median and standard deviation of the logarithm, of the size over the test space in parts of the data's
standard deviation, and of a length scale in parts of an axis."""


class Predicted(NamedTuple):
    """ρ of an improved simulator minus ρ of the nominal one: (n,) at the tests that were run, (m,) on the grid."""

    tests: FloatArray
    grid: FloatArray


class Band(NamedTuple):
    """A simultaneous band, (m,) each: with probability 0.95 a function is between its limits on the whole grid."""

    mean: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True)
class LargestGap:
    """The expected |Δρ| at its worst test.

    Attributes:
        estimate: the estimate, in the unit.
        low: the lower end of the 95 % interval.
        high: the upper end of the 95 % interval.
        unit: the unit of ρ.
    """

    estimate: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, eq=False)
class GapSurface(Shown):
    """Where in the test space the gap lies.

    Attributes:
        space: the test space.
        unit: the unit of ρ.
        tests: ρ at the tests that were run.
        grid: (m, dim) places.
        signed: E Δρ at these places; negative where the real machine is worse.
        floor: E|Δρ| of the simulator against itself; None if no test was simulated twice.
        worst: the test where E|Δρ| is probably largest.
        worst_probability: the probability of being within a tenth of every axis of the worst test.
        worst_within: parameter → central 90 % interval of the worst test.
        largest: E|Δρ| at the worst test.
        tolerance: twice the |Δρ| that scatter alone causes; None if no test was simulated twice.
        notes: limits of the data, each in one sentence.
    """

    space: Space
    unit: str
    tests: tuple[RolloutsAtTest, ...]
    grid: FloatArray
    signed: Band
    floor: float | None
    worst: Mapping[str, float]
    worst_probability: Probability
    worst_within: Mapping[str, Ends]
    largest: LargestGap
    tolerance: float | None
    notes: tuple[str, ...]

    JSON = "worst worst_probability worst_within largest floor tolerance notes"

    def along(self, axis: int) -> NDArray[np.intp]:
        """Return the places of the grid on the line along an axis through the worst test."""
        same = np.isclose(self.grid, self.space.vector(self.worst))
        return np.flatnonzero(np.delete(same, axis, axis=1).all(axis=1))


def grid_of(space: Space) -> FloatArray:
    """Return the grid (m, dim) over the test space.

    Raises:
        UsageError: the space has no or more than four parameters.
    """
    if space.dim not in COUNTS:
        raise UsageError(
            f"s2r locates the gap in a test space of one to four parameters, and the spec has {space.dim}"
        )
    return space.grid((COUNTS[space.dim],) * space.dim)


def in_cube(space: Space, points: FloatArray) -> FloatArray:
    """Return (n, dim) coordinates of points in the unit cube."""
    scaled: FloatArray = (points - space.lower) / (space.upper - space.lower)
    return scaled


def gap_surface(
    space: Space,
    tests: tuple[RolloutsAtTest, ...],
    unit: str = "",
    seed: int = 0,
    predicted: Predicted | None = None,
) -> GapSurface:
    """Return the gap over the test space, from one entry for each test; see :class:`GapSurface`.

    ``predicted`` is the gap that an improved simulator predicts.

    Raises:
        UsageError: there is no test, or the space has no or more than four parameters.
    """
    if not tests:
        raise UsageError(
            "s2r needs at least one real rollout to locate the gap in the test space, and there is none"
        )
    grid = grid_of(space)
    signed, scatter = _sample(space, tests, predicted, np.random.default_rng(seed))
    size = folded_normal_mean(signed, scatter)
    largest = size.max(axis=1)
    # The worst test is where most functions are largest, seen through a triangular kernel over a tenth of every axis.
    places = grid[size.argmax(axis=1)]
    distinct, counts = np.unique(in_cube(space, places), axis=0, return_counts=True)
    near = np.clip(1.0 - 10.0 * np.abs(distinct[:, None] - distinct), 0.0, None).prod(axis=2) @ counts
    worst = space.at(distinct[near.argmax()])
    low, high = np.quantile(places, [0.05, 0.95], axis=0).tolist()
    perfect = floor(tests)
    least, most = np.quantile(largest, [LEVEL / 2, 1.0 - LEVEL / 2]).tolist()
    return GapSurface(
        space,
        unit,
        tests,
        grid,
        _band(signed),
        perfect,
        space.point(worst),
        float((np.abs(places - worst) <= 0.1 * (space.upper - space.lower) + 1e-12).all(axis=1).mean()),
        dict(zip(space.names, zip(low, high, strict=True), strict=True)),
        LargestGap(float(np.median(largest)), least, most, unit),
        None if perfect is None else 2.0 * perfect,
        _notes(space, tests),
    )


def _sample(
    space: Space, tests: Sequence[RolloutsAtTest], predicted: Predicted | None, generator: np.random.Generator
) -> tuple[FloatArray, float]:
    """Return (DRAWS, m) samples of the signed gap, of both models by their evidence, and the scatter of Δρ of a pair.

    Errors follow from the variance within tests, pooled over all. The scatter of one pair follows from the median over
    tests, which a few falls hardly change.
    """
    own, other = (
        _within_variance([test.real for test in tests]),
        _within_variance([test.simulated for test in tests]),
    )
    # A side without replicates has the variance of the other side; without any replicates it is 0.
    own, other = (np.nan_to_num(np.where(np.isnan(a), b, a)) for a, b in ((own, other), (other, own)))
    counts = np.array([(test.real.size, test.simulated.size) for test in tests])
    error = np.sqrt(own[0] / counts[:, 0] + other[0] / counts[:, 1])
    gap, scatter = np.array([test.gap for test in tests]), float(np.sqrt(own[1] + other[1]))
    at = in_cube(space, np.array([space.vector(test.params) for test in tests]))
    grid = in_cube(space, grid_of(space))
    plain, evidence = _functions(at, gap, error, grid, DRAWS, generator)
    if predicted is None:
        return plain, scatter
    left, of_left = _functions(at, gap - predicted.tests, error, grid, DRAWS, generator)
    share = 1.0 / (1.0 + np.exp(np.clip(evidence - of_left, -50.0, 50.0)))
    count = round(DRAWS * min(float(share), MOST_PREDICTED))
    # Functions with one size and length scale are neighbours, so a random order takes from all of them.
    picked = generator.permutation(DRAWS)
    return np.concatenate([predicted.grid + left[picked[:count]], plain[picked[count:]]]), scatter


def _functions(
    at: FloatArray,
    values: FloatArray,
    errors: FloatArray,
    grid: FloatArray,
    count: int,
    generator: np.random.Generator,
) -> tuple[FloatArray, float]:
    """Return (count, m) functions from the posterior, and the log evidence of the process.

    Data are (n,) values at (n, dim) places, with standard errors; functions are at (m, dim) places of a grid.
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
    own, between, free = _squares(at, at), _squares(at, grid), _squares(grid, grid)
    roots = np.linalg.cholesky([_covariance(*one, own) + noise for one in zip(sizes, lengths, strict=True)])
    white = np.linalg.solve(roots, scaled[:, None])[..., 0]
    log = -np.square(white).sum(axis=1) / 2 - np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    weights = np.exp(log - log.max())
    sums = np.cumsum(weights)
    picked = np.searchsorted(sums / sums[-1], (np.arange(KEPT) + generator.uniform()) / KEPT)
    sampled = []
    for k, times in zip(*np.unique(picked[np.arange(count) % KEPT], return_counts=True), strict=True):
        across = np.linalg.solve(roots[k], _covariance(sizes[k], lengths[k], between))
        left = _covariance(sizes[k], lengths[k], free) - across.T @ across
        left[np.diag_indices_from(left)] += 1e-6 * (1.0 + sizes[k] ** 2)
        normal = generator.standard_normal((times, len(grid)))
        sampled.append(white[k] @ across + normal @ np.linalg.cholesky(left).T)
    evidence = float(np.log(weights.mean()) + log.max()) - len(values) * float(np.log(scale))
    return level + scale * np.concatenate(sampled), evidence


def _squares(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return (n, m, dim) squared differences of (n, dim) and (m, dim) places."""
    return np.asarray(np.square(left[:, None] - right))


def _covariance(size: float, lengths: FloatArray, squares: FloatArray) -> FloatArray:
    """Return (n, m) covariance by (n, m, dim) squared differences of places: Matérn-5/2, plus 1 for the constant."""
    square = 5.0 * squares @ lengths**-2.0
    far = np.sqrt(square)
    shape: FloatArray = 1.0 + size**2 * (1.0 + far + square / 3.0) * np.exp(-far)
    return shape


def _within_variance(samples: Sequence[FloatArray]) -> FloatArray:
    from scipy.stats import chi2

    repeated = [one for one in samples if one.size > 1]
    if not repeated:
        return np.full(2, np.nan)
    freedom = np.array([one.size - 1 for one in repeated])
    variances = np.array([one.var(ddof=1) for one in repeated])
    medians = variances / (chi2.median(freedom) / freedom)
    return np.array([np.average(variances, weights=freedom), np.median(medians)])


def folded_normal_mean(mean: FloatArray, scatter: float) -> FloatArray:
    """Return E|Δ| of normal Δ with this mean and standard deviation (the folded normal distribution)."""
    from scipy.special import erf

    z = mean / scatter if scatter else np.copysign(np.inf, mean)
    return np.asarray(scatter * np.sqrt(2 / np.pi) * np.exp(-np.square(z) / 2) + mean * erf(z / np.sqrt(2)))


def floor(tests: Sequence[RolloutsAtTest]) -> float | None:
    """Return E|ρ − ρ'| of two simulated rollouts of the same test: E|Δρ| of a perfect simulator.

    None if no test was simulated twice.
    """
    several = [test.simulated for test in tests if test.simulated.size > 1]
    return float(np.mean([mean_difference(one) for one in several])) if several else None


def _band(sampled: FloatArray) -> Band:
    mean, deviation = sampled.mean(axis=0), sampled.std(axis=0)
    width = np.quantile((np.abs(sampled - mean) / np.maximum(deviation, 1e-300)).max(axis=1), 1.0 - LEVEL)
    return Band(mean, mean - width * deviation, mean + width * deviation)


def _notes(space: Space, tests: Sequence[RolloutsAtTest]) -> tuple[str, ...]:
    notes = []
    replicated = sum(test.real.size >= 3 for test in tests)
    if 3 * replicated < len(tests):
        notes.append(
            f"{replicated} of {len(tests)} tests have three or more real rollouts; repeat a third of the tests to "
            f"separate noise from the shape of the gap"
        )
    if len(tests) < 2 * space.dim + 1:
        notes.append(
            f"the gap was measured at {len(tests)} test{'s' * (len(tests) != 1)} of a space with {space.dim} "
            f"parameter{'s' * (space.dim != 1)}; elsewhere it is a guess"
        )
    return tuple(notes)
