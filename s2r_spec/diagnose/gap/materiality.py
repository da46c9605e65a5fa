"""Decide whether a gap matters: a test of every test of the space, over all real rollouts.

Data, at each of T tests t: n_t real and m_t simulated values of ρ, of rollouts that ran to their end, and the number
of rollouts of either kind that ended early. Unknown: the mean ρ of the machine, μ_t, and of the simulator, ν_t. |ν_t|
is the *margin*, d_t = μ_t − ν_t the *gap*. Model:

    real ρ = μ_t + r σ_t ε,   simulated ρ = ν_t + σ_t ε',   ε of mean 0 and variance 1, with a log-concave density
    σ_t² ~ scaled inverse χ²(d₀, s₀²)                       one prior for all tests
    log r ~ |N(0, RATIO²)|                                  the machine scatters at least as the simulator does

Log-concave densities include the normal, the logistic, the exponential and Gumbel's, so ρ may be skewed. Estimators:
d₀ and s₀² by moments of log s_t² (Smyth 2004), r by its posterior given replicated real tests, d_t by the difference
d̂_t of both sample means. With σ̃_t² the posterior mean of σ_t², W ~ χ²_d/d its error, and z the gap in standard errors,
each gap has the two-sided p-value

    p_t = E_{r, W} tail(z),   z = |d̂_t| √W / (σ̃_t √(r²/n_t + 1/m_t)),   P(|ε| ≥ z) ≤ tail(z)

and an interval d̂_t ± h_t, where h_t is the gap of p-value LEVEL/T. All T intervals hold at once with probability
1 − LEVEL (Bonferroni). The gap *matters* at a test if its interval excludes 0, and does not lie within ±HALF of the
margin. A change of sign is the special case |d_t| ≥ |ν_t|. So a machine without a gap is called material with a
probability of at most LEVEL, also at a margin of 0, on average over the prior of r. And *no material gap* is not said
of a difference that the data show, unless they also show that it takes at most half of the margin.

A rollout that ended early failed the requirement, and has no ρ of its own: the value in the spec is a convention. So it
enters by a count. Without a gap, real and simulated rollouts of a test are exchangeable, so the real ones among the
failed are hypergeometric; the p-value sums the probabilities of all tables that are at most as likely as the observed
one (Freeman and Halton 1951, stratified by test). Where any rollout failed, ρ and failures share LEVEL equally.

Assumes independent rollouts. Without a replicated real test, only the prior says how the machine scatters. Units: those
of ρ. Sources: Smyth, *Statistical Applications in Genetics and Molecular Biology* 3 (2004); for the tail, Vysochanskij
and Petunin (1980) below three deviations, and above them e^(−1−z), which the exponential density attains. A numerical
search found no log-concave density that exceeds it there by more than 4 %; only e^(1−z) is proved (Lovász and Vempala,
*Random Structures & Algorithms* 30, 2007).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.gap import LEVEL
from s2r_spec.errors import UsageError

FloatArray = NDArray[np.float64]

HALF = 0.5
"""Definition: part of the simulated margin that a gap may take without mattering. Doubled, a gap matters only if it may
change the sign of ρ, or double ρ."""
RATIO = 0.4
"""Prior: standard deviation of the logarithm of the ratio r of both standard deviations, without its sign. Half of all
machines scatter at most 1.3 times as much as their simulator, 19 of 20 at most 2.2 times. `python
benchmarks/materiality.py --a1` prints this ratio for a twin of other code. Doubled, intervals of single real
rollouts get 2.3 times as long; halved, 24 % shorter."""
ROUNDING = 1e-9
"""Tolerance: rounding error of ρ, in parts of the largest |ρ|. Doubled, nothing changes where ρ scatters."""
NODES = 16
"""Budget: values of r and of W over which p-values are averaged. Doubled, intervals change by 0.1 %."""
EDGE = 1e-7
"""Tolerance: probability of W that is cut off at either end. Doubled, no digit of an answer changes."""


@dataclass(frozen=True, eq=False)
class RolloutsAtTest:
    """All rollouts of one test.

    Args:
        params: the test.
        real: (n,) ρ of the real rollouts that ran to their end.
        simulated: (m,) ρ of the simulated ones.
        real_failed: number of real rollouts that ended early.
        simulated_failed: number of simulated ones.
    """

    params: Mapping[str, float]
    real: FloatArray
    simulated: FloatArray
    real_failed: int = 0
    simulated_failed: int = 0

    @property
    def gap(self) -> float:
        """Mean real ρ less mean simulated ρ."""
        return float(self.real.mean() - self.simulated.mean())


@dataclass(frozen=True)
class GapAtTest:
    """The gap at one test, in the unit of ρ.

    Attributes:
        params: the test.
        rollouts: real rollouts that ran to their end.
        real: mean ρ of these.
        simulated: mean ρ of the simulated ones.
        low: lower end of the gap's interval; the intervals of all tests hold at once.
        high: upper end.
        p: p-value of no gap at this test alone.
    """

    params: Mapping[str, float]
    rollouts: int
    real: float
    simulated: float
    low: float
    high: float
    p: float

    @property
    def gap(self) -> float:
        """Mean real ρ less mean simulated ρ; negative where the machine is worse."""
        return self.real - self.simulated

    @property
    def differs(self) -> bool:
        """Whether the gap is more than scatter."""
        return self.low > 0.0 or self.high < 0.0

    @property
    def matters(self) -> bool:
        """Whether the gap is more than scatter, and may take more than half of the simulated margin."""
        return self.differs and max(-self.low, self.high) > HALF * abs(self.simulated)

    @property
    def changes_sign(self) -> bool:
        """Whether the gap is more than scatter, and one of both means is negative."""
        return self.differs and self.real * self.simulated < 0.0

    def to_json(self) -> dict[str, Any]:
        """Return the fields."""
        own = asdict(self) | {"gap": self.gap, "changes_sign": self.changes_sign}
        return own | {"params": dict(self.params)}


@dataclass(frozen=True)
class Failures:
    """Rollouts that ended early, over all tests.

    Attributes:
        real: number of real ones.
        real_rollouts: of so many.
        simulated: number of simulated ones.
        simulated_rollouts: of so many.
        p: p-value of both failing alike, times two.
    """

    real: int
    real_rollouts: int
    simulated: int
    simulated_rollouts: int
    p: float

    @property
    def matters(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p <= LEVEL


@dataclass(frozen=True)
class Materiality:
    """Whether the gap matters.

    Attributes:
        tests: the gap at each test with whole rollouts of both kinds, in the order of the data.
        failures: rollouts that ended early; None without any.
        unit: of ρ.
        tolerance: the smallest constant that the requirement compares a signal with, in this unit; None without one.
    """

    tests: tuple[GapAtTest, ...]
    failures: Failures | None
    unit: str
    tolerance: float | None = None

    @property
    def places(self) -> tuple[GapAtTest, ...]:
        """The tests at which the gap matters, largest gap first."""
        return tuple(sorted((at for at in self.tests if at.matters), key=lambda at: -abs(at.gap)))

    @property
    def matters(self) -> bool:
        """Whether the gap matters at any test, or failures do."""
        return bool(self.places) or (self.failures is not None and self.failures.matters)

    @property
    def largest(self) -> GapAtTest | None:
        """The largest gap of those that matter, or of all where none does; None without tests."""
        return max(self.places or self.tests, key=lambda at: abs(at.gap), default=None)

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "matters": self.matters,
            "level": LEVEL,
            "tests": len(self.tests),
            "unit": self.unit,
            "tolerance": self.tolerance,
            "largest": None if self.largest is None else self.largest.to_json(),
            "places": [at.to_json() for at in self.places],
            "failures": None if self.failures is None else asdict(self.failures),
        }


def materiality(
    tests: Sequence[RolloutsAtTest], unit: str = "", tolerance: float | None = None
) -> Materiality:
    """Return at which tests the gap matters.

    Args:
        tests: T of them, each once.
        unit: of ρ.
        tolerance: see :class:`Materiality`.

    Raises:
        UsageError: a ρ is infinite or not a number.
    """
    _refuse_not_finite(tests)
    failures = _failures(tests)
    both = [test for test in tests if test.real.size and test.simulated.size]
    half, p = _intervals(both, LEVEL / (max(len(both), 1) * (1 if failures is None else 2)))
    found = []
    for test, h, each in zip(both, half.tolist(), p.tolist(), strict=True):
        means = float(test.real.mean()), float(test.simulated.mean())
        ends = test.gap - h, test.gap + h
        found.append(GapAtTest(dict(test.params), test.real.size, *means, *ends, each))
    return Materiality(tuple(found), failures, unit, tolerance)


def moderated(variances: FloatArray, freedom: FloatArray) -> tuple[FloatArray, float]:
    """Return posterior means (T,) of variances, and their degrees of freedom.

    Args:
        variances: (T,) sample variances s_t² > 0.
        freedom: (T,) degrees of freedom of each, f_t ≥ 1.

    The prior's d₀ and s₀² match mean and variance of log s_t²; d₀ is infinite where that varies no more than f_t says.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, polygamma

    logs = np.log(variances) - digamma(freedom / 2.0) + np.log(freedom / 2.0)
    excess = float(logs.var(ddof=1) - polygamma(1, freedom / 2.0).mean()) if logs.size > 1 else 0.0
    total = float(freedom.sum())
    if excess <= 0.0:
        return np.full(variances.size, float(variances @ freedom) / total), total
    # The trigamma function of x lies between 1/x and 1/(x − 1/2).
    prior = 2.0 * brentq(lambda x: float(polygamma(1, x)) - excess, 0.5 / excess, 1.0 + 2.0 / excess)
    size = math.exp(float(logs.mean()) + float(digamma(prior / 2.0)) - math.log(prior / 2.0))
    posterior = (prior * size + freedom * variances) / (prior + freedom)
    return posterior, min(prior + float(freedom.mean()), total)


def tail(z: FloatArray) -> FloatArray:
    """Return a bound on P(|ε| ≥ z) of every log-concave density of mean 0 and variance 1."""
    near = 4.0 / (9.0 * np.maximum(z, 1e-9) ** 2)
    return np.where(z < 3.0, np.minimum(1.0, near), np.exp(-1.0 - np.maximum(z, 3.0)))


def same_failures(tables: Sequence[tuple[int, int, int, int]]) -> float:
    """Return the p-value of real and simulated rollouts failing alike.

    Args:
        tables: (real failed, real rollouts, simulated failed, simulated rollouts) of each test.
    """
    from scipy.stats import hypergeom

    observed = 0.0
    sums = {0.0: 1.0}
    for failed, real, other, simulated in tables:
        counts = np.arange(max(0, failed + other - simulated), min(real, failed + other) + 1)
        masses = hypergeom.pmf(counts, real + simulated, failed + other, real)
        observed += math.log(masses[counts == failed].item())
        after: dict[float, float] = {}
        for log, mass in sums.items():
            for own in masses.tolist():
                key = round(log + math.log(own), 9)
                after[key] = after.get(key, 0.0) + mass * own
        sums = after
    return min(1.0, sum(mass for log, mass in sums.items() if log <= observed + 1e-6))


def _failures(tests: Sequence[RolloutsAtTest]) -> Failures | None:
    """Return the rollouts that ended early; None without any."""
    tables = [
        (
            t.real_failed,
            t.real_failed + t.real.size,
            t.simulated_failed,
            t.simulated_failed + t.simulated.size,
        )
        for t in tests
    ]
    real, of, simulated, among = np.sum([(0, 0, 0, 0), *tables], axis=0).tolist()
    if not real + simulated:
        return None
    return Failures(real, of, simulated, among, min(1.0, 2.0 * same_failures(tables)))


def _intervals(tests: Sequence[RolloutsAtTest], level: float) -> tuple[FloatArray, FloatArray]:
    """Return half-widths (T,) of intervals around the gaps, and the p-values (T,) of these gaps."""
    half, p = np.empty(len(tests)), np.empty(len(tests))
    if not tests:
        return half, p
    scale = ROUNDING * max(float(np.abs(one).max()) for test in tests for one in (test.real, test.simulated))
    deviation, freedom = _scatter(tests, scale)
    least = np.maximum(deviation, max(scale, 1e-300))
    squares = [((one.real - one.real.mean()) ** 2).sum() / v**2 for one, v in zip(tests, least, strict=True)]
    ratio, of_ratio = _ratio(float(np.sum(squares)), sum(one.real.size - 1 for one in tests))
    error, of_error = _variance_error(freedom)
    weights = np.outer(of_ratio, of_error).ravel()
    sizes = [(test.real.size, test.simulated.size) for test in tests]
    gaps = np.array([test.gap for test in tests])
    for n, m in dict.fromkeys(sizes):
        alike = np.array([size == (n, m) for size in sizes])
        unit = (np.sqrt(ratio**2 / n + 1.0 / m)[:, None] / np.sqrt(error)).ravel()
        half[alike] = np.maximum(deviation[alike] * _quantile(unit, weights, level), scale)
        z = np.abs(gaps[alike, None]) / np.maximum(deviation[alike, None] * unit, max(scale, 1e-300))
        p[alike] = tail(z) @ weights
    return half, p


def _scatter(tests: Sequence[RolloutsAtTest], scale: float) -> tuple[FloatArray, float]:
    """Return standard deviations (T,) of ρ of simulated rollouts, and their degrees of freedom.

    Without scatter in the simulator, the scatter of replicated real rollouts stands for both.

    Args:
        tests: T of them.
        scale: rounding error of ρ.
    """
    base = [test.simulated for test in tests]
    if all(one.size < 2 or np.ptp(one) <= scale for one in base):
        base = [test.real for test in tests]
    repeated = np.array([one.size > 1 for one in base])
    if not repeated.any():
        return np.zeros(len(tests)), 1.0
    samples = [one for one in base if one.size > 1]
    own, freedom = moderated(
        np.array([max(float(one.var(ddof=1)), scale**2, 1e-300) for one in samples]),
        np.array([one.size - 1.0 for one in samples]),
    )
    variance = np.full(len(tests), float(own.mean()))
    variance[repeated] = own
    return np.sqrt(variance), freedom


def _ratio(squares: float, freedom: int) -> tuple[FloatArray, FloatArray]:
    """Return values (NODES,) of r and their posterior weights.

    Args:
        squares: sum of squares of real rollouts around their test's mean, in units of the simulator's variances.
        freedom: its degrees of freedom; 0 for the prior.
    """
    most = 4.0 * RATIO + (0.5 * max(math.log(max(squares, 1e-300) / freedom), 0.0) if freedom else 0.0)
    logs = most * (np.arange(NODES) + 0.5) / NODES
    weight = -0.5 * (logs / RATIO) ** 2 - freedom * logs - 0.5 * squares * np.exp(-2.0 * logs)
    weight = np.exp(weight - weight.max())
    return np.exp(logs), weight / weight.sum()


def _variance_error(freedom: float) -> tuple[FloatArray, FloatArray]:
    """Return values (NODES,) of W ~ χ²_d/d and their weights, by Gauss and Legendre's rule for log W."""
    from scipy.special import gammaincinv

    shape = freedom / 2.0
    ends = np.log(gammaincinv(shape, [EDGE, 1.0 - EDGE]) / shape)
    at, weight = np.polynomial.legendre.leggauss(NODES)
    logs = 0.5 * (ends[1] - ends[0]) * at + ends.mean()
    density = shape * (logs - np.exp(logs))
    weight = weight * np.exp(density - density.max())
    return np.exp(logs), weight / weight.sum()


def _quantile(errors: FloatArray, weights: FloatArray, level: float) -> float:
    """Return the gap of which the p-value is ``level``, for standard errors and their weights."""
    from scipy.optimize import brentq

    most = float(errors.max()) * (1.0 - math.log(level))
    return float(brentq(lambda gap: float(tail(gap / errors) @ weights) - level, 0.0, most))


def _refuse_not_finite(tests: Sequence[RolloutsAtTest]) -> None:
    """Raise an error where a ρ is infinite or not a number."""
    for test in tests:
        for whose, values in (("real", test.real), ("simulated", test.simulated)):
            for value in values[~np.isfinite(values)].tolist():
                at = ", ".join(f"{name} = {number:g}" for name, number in test.params.items()) or "the test"
                raise UsageError(
                    f"ρ of a {whose} rollout at {at} is {value}; remove 'true', flags and empty windows from the "
                    f"requirement, so that ρ is finite"
                )
