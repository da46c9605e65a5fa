"""Decide whether a gap matters: a test of every test of the space, over all real rollouts.

Data, at each of T tests t: n_t real and m_t simulated values of ρ, of rollouts that ran to their end, and the number
of rollouts of either kind that ended early. Unknown: the mean ρ of the machine, μ_t, and of the simulator, ν_t. |ν_t|
is the *margin*, d_t = μ_t − ν_t the *gap*. Model:

    real ρ = μ_t + r σ_t ε,   simulated ρ = ν_t + σ_t ε',   ε of mean 0 and variance 1, with a log-concave density
    σ_t² ~ scaled inverse χ²(d₀, s₀²)                       one prior for all tests
    log r ~ |N(0, RATIO²)|                                  the machine scatters at least as the simulator does

Log-concave densities include skewed ones, such as Gumbel's. Estimators: d₀ and s₀² by moments of log s_t² (Smyth 2004),
r by its posterior given replicated real tests, d_t by the difference d̂_t of both sample means. With σ̃_t² the
posterior mean of σ_t², W ~ χ²_d/d its error, and z the gap in standard errors, each gap has the two-sided p-value

    p_t = E_{r, W} tail(z),   z = |d̂_t| √W / (σ̃_t √(r²/n_t + 1/m_t)),   P(|ε| ≥ z) ≤ tail(z)

and an interval d̂_t ± h_t, where h_t is the gap of p-value LEVEL/T. All T intervals hold at once with probability
1 − LEVEL (Bonferroni). The gap *matters* at a test if its interval excludes 0, and does not lie within ±HALF of the
margin. So a machine without a gap is called material with a probability of at most LEVEL, also at a margin of 0, on
average over the prior of r. And *no material gap* is not said of a difference that the data show, unless they also show
that it takes at most half of the margin.

A rollout that ended early has no ρ of its own, since the value in the spec is a convention, so it enters by a count.
Without a gap, real and simulated rollouts of a test are exchangeable, so the real ones among the failed are
hypergeometric; the p-value sums the probabilities of all tables that are at most as likely as the observed one (Freeman
and Halton 1951, stratified by test). Where any rollout failed, ρ and failures share LEVEL equally.

Assumes independent rollouts. Without a replicated real test, only the prior says how the machine scatters. Units: those
of ρ. Sources: Smyth, *Statistical Applications in Genetics and Molecular Biology* 3 (2004); for the tail, Vysochanskij
and Petunin (1980) below three deviations, and above them e^(−1−z), which the exponential density attains. A numerical
search found no log-concave density that exceeds it there by more than 4 %; only e^(1−z) is proved (Lovász and Vempala,
*Random Structures & Algorithms* 30, 2007).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_types import Count, Probability
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.gap import LEVEL, ROUNDING
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.simulator.bench import Bench, TestRun, places_of, rho_and_end
from s2r_spec.lang import formula as f
from s2r_spec.lang.constants import constant

HALF = 0.5
"""Definition: part of the simulated margin that a gap may take without mattering."""
RATIO = 0.4
"""Prior: standard deviation of the logarithm of the ratio r of both standard deviations, without its sign. Half of all
machines scatter at most 1.3 times as much as their simulator, 19 of 20 at most 2.2 times. `python -m
benchmarks.diagnose.materiality --a1` prints this ratio for a twin of other code."""
NODES = 16
"""Budget: values of r and of W over which p-values are averaged."""


@dataclass(frozen=True, eq=False)
class RolloutsAtTest:
    """(n,) real and (m,) simulated ρ of rollouts of one test that ran to their end, and how many ended early."""

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
class GapAtTest(Shown):
    """The gap at one test, in the unit of ρ.

    Attributes:
        params: the test.
        rollouts: number of real rollouts that ran to their end.
        real: mean ρ of these.
        simulated: mean ρ of the simulated rollouts; its size is the margin.
        low: the lower end of the gap's interval; the intervals of all tests hold at once with probability 95 %.
        high: the upper end.
        p: p-value of no gap, at this test alone.
    """

    params: Mapping[str, float]
    rollouts: Count
    real: float
    simulated: float
    low: float
    high: float
    p: Probability

    JSON = "params rollouts real simulated low high p gap changes_sign"

    @property
    def gap(self) -> float:
        """Mean real ρ minus mean simulated ρ."""
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


@dataclass(frozen=True)
class Failures:
    """Rollouts that ended early, over all tests.

    Attributes:
        real: number of real rollouts that ended early.
        real_rollouts: number of real rollouts.
        simulated: number of simulated rollouts that ended early.
        simulated_rollouts: number of simulated rollouts.
        p: p-value of both ending early alike, times two, because ρ has the other half of the level.
    """

    real: Count
    real_rollouts: Count
    simulated: Count
    simulated_rollouts: Count
    p: Probability

    @property
    def matters(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p <= LEVEL


@dataclass(frozen=True)
class Materiality(Shown):
    """Whether the gap matters, over all real rollouts.

    Attributes:
        tests: the gap at each test with whole rollouts of both kinds, in the order of the data.
        failures: rollouts that ended early; None without any.
        unit: the unit of ρ.
        tolerance: the smallest constant that the requirement compares a signal with, in the unit; None without one.
    """

    tests: tuple[GapAtTest, ...]
    failures: Failures | None
    unit: str
    tolerance: float | None = None

    JSON = "matters level tests=count unit tolerance largest places failures"

    @property
    def level(self) -> Probability:
        """The probability of a material gap where there is none."""
        return LEVEL

    @property
    def count(self) -> Count:
        """Number of tests with whole rollouts of both kinds."""
        return len(self.tests)

    @property
    def places(self) -> tuple[GapAtTest, ...]:
        """The tests at which the gap matters, largest gap first."""
        return tuple(sorted((at for at in self.tests if at.matters), key=lambda at: -abs(at.gap)))

    @property
    def matters(self) -> bool:
        """Whether it matters at any test, or rollouts end early more often on one side."""
        return bool(self.places) or (self.failures is not None and self.failures.matters)

    @property
    def largest(self) -> GapAtTest | None:
        """The largest gap of those that matter, or of all where none does; None without tests."""
        return max(self.places or self.tests, key=lambda at: abs(at.gap), default=None)


def compared_at_all_tests(bench: Bench, rollouts: Sequence[TestRun], nominal: Nominal) -> Materiality:
    """Return whether the gap matters at any test of the real rollouts, also of those that ended early.

    Raises:
        UsageError: a ρ is infinite or not a number.
    """
    real = np.array([rho_and_end(bench, trace, test) for test, trace in rollouts])
    tests = []
    for key, own in places_of([test for test, _ in rollouts]).items():
        sides = [(real[own, 0], real[own, 1] > 0.0), (nominal.before.rho[key], nominal.before.ended[key])]
        whole = [rho[~ended] for rho, ended in sides]
        tests.append(RolloutsAtTest(dict(key), *whole, *(int(ended.sum()) for _, ended in sides)))
    formula = bench.spec.formulas[bench.requirement]
    return materiality(tests, bench.spec.unit(bench.requirement), smallest_tolerance(formula))


def smallest_tolerance(formula: f.Formula) -> float | None:
    """Return the smallest positive constant that a predicate compares a signal with, in the unit of ρ.

    None where no predicate has one, or where ρ is a minimum of different dimensions.
    """
    if formula.unit == f.MIXED:
        return None
    sizes = []
    for node in f.walk(formula):
        for side in (node.left, node.right) if isinstance(node, f.Comparison) else ():
            value = constant(side)
            # A number of degrees Celsius is no difference, so no tolerance.
            if value and not (side.unit and side.unit.offset):
                scale = side.unit.to(formula.unit).factor if side.unit and formula.unit else 1.0
                sizes.append(abs(value) * scale)
    return min(sizes, default=None)


def materiality(
    tests: Sequence[RolloutsAtTest], unit: str = "", tolerance: float | None = None
) -> Materiality:
    """Return at which of the tests, each of which is there once, the gap matters.

    Raises:
        UsageError: a ρ is infinite or not a number.
    """
    for test in tests:
        for whose, values in (("real", test.real), ("simulated", test.simulated)):
            for value in values[~np.isfinite(values)].tolist():
                at = ", ".join(f"{name} = {number:g}" for name, number in test.params.items()) or "the test"
                raise UsageError(
                    f"ρ of a {whose} rollout at {at} is {value}; remove 'true', flags and empty windows from the "
                    f"requirement, so that ρ is finite"
                )
    failed = [
        (
            t.real_failed,
            t.real_failed + t.real.size,
            t.simulated_failed,
            t.simulated_failed + t.simulated.size,
        )
        for t in tests
    ]
    tables = np.array(failed).reshape(-1, 4)
    failures = None
    if tables[:, [0, 2]].any():
        real, of, simulated, among = tables.sum(axis=0).tolist()
        failures = Failures(real, of, simulated, among, min(1.0, 2.0 * same_failures(tables.tolist())))
    both = [test for test in tests if test.real.size and test.simulated.size]
    half, p_values = _intervals(both, LEVEL / (max(len(both), 1) * (1 if failures is None else 2)))
    gaps = tuple(
        GapAtTest(
            dict(test.params), test.real.size, float(test.real.mean()), float(test.simulated.mean()),
            test.gap - h, test.gap + h, p,
        )
        for test, h, p in zip(both, half.tolist(), p_values.tolist(), strict=True)
    )  # fmt: skip
    return Materiality(gaps, failures, unit, tolerance)


def same_failures(tables: Sequence[Sequence[int]]) -> float:
    """Return the p-value of real and simulated rollouts failing alike.

    Each test has a table: real failed, real rollouts, simulated failed, simulated rollouts.
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


def moderate(variances: FloatArray, freedom: FloatArray) -> tuple[FloatArray, float]:
    """Return posterior means (T,) of sample variances > 0 with (T,) degrees of freedom ≥ 1, and the means' own degrees.

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


def mean_difference(values: FloatArray) -> float:
    """Return the mean |difference| of two of (n,) values: 2/√π of the standard deviation if these are normal."""
    return float(np.abs(values[:, None] - values).sum()) / (values.size * (values.size - 1))


def tail(z: FloatArray) -> FloatArray:
    """Return a bound on P(|ε| ≥ z) of every log-concave density of mean 0 and variance 1."""
    near = 4.0 / (9.0 * np.maximum(z, 1e-9) ** 2)
    return np.where(z < 3.0, np.minimum(1.0, near), np.exp(-1.0 - np.maximum(z, 3.0)))


def _intervals(tests: Sequence[RolloutsAtTest], level: float) -> tuple[FloatArray, FloatArray]:
    """Return half-widths (T,) of intervals around the gaps, and the p-values (T,) of these gaps."""
    from scipy.optimize import brentq

    half, p = np.empty(len(tests)), np.empty(len(tests))
    if not tests:
        return half, p
    scale = ROUNDING * max(float(np.abs(one).max()) for test in tests for one in (test.real, test.simulated))
    scale = max(scale, 1e-300)
    deviation, freedom = _scatter(tests, scale)
    squares = sum(
        float(((t.real - t.real.mean()) ** 2).sum()) / max(d, scale) ** 2
        for t, d in zip(tests, deviation, strict=True)
    )
    ratio, error, weights = _errors(squares, sum(one.real.size - 1 for one in tests), freedom)

    def above(gap: float, errors: FloatArray, less: float = 0.0) -> float:
        return float(tail(gap / errors) @ weights) - less

    at_level: dict[tuple[int, int], float] = {}
    for k, test in enumerate(tests):
        n, m = test.real.size, test.simulated.size
        unit = np.sqrt((ratio**2 / n + 1.0 / m) / error)
        if (n, m) not in at_level:
            most = float(unit.max()) * (1.0 - math.log(level))
            at_level[n, m] = brentq(above, 0.0, most, args=(unit, level))
        half[k] = max(deviation[k] * at_level[n, m], scale)
        p[k] = above(abs(test.gap), np.maximum(deviation[k] * unit, scale))
    return half, p


def _scatter(tests: Sequence[RolloutsAtTest], scale: float) -> tuple[FloatArray, float]:
    """Return standard deviations (T,) of ρ of simulated rollouts, and their degrees of freedom.

    If a simulator scatters less than ``scale``, ρ's rounding error, replicated real rollouts stand for both.
    """
    samples = [test.simulated for test in tests]
    if all(np.ptp(one) <= scale for one in samples):
        samples = [test.real for test in tests]
    repeated = np.array([one.size > 1 for one in samples])
    if not repeated.any():
        return np.zeros(len(tests)), 1.0
    own, freedom = moderate(
        np.array([max(float(one.var(ddof=1)), scale**2, 1e-300) for one in samples if one.size > 1]),
        np.array([one.size - 1.0 for one in samples if one.size > 1]),
    )
    variance = np.full(len(tests), float(own.mean()))
    variance[repeated] = own
    return np.sqrt(variance), freedom


def _errors(squares: float, of: int, freedom: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pairs of r and W ~ χ²_d/d, each (NODES²,), and their posterior weights.

    W has nodes by Gauss and Legendre's rule for its logarithm, and d is ``freedom``. r is known by a sum of ``squares``
    of real rollouts around their test's mean [simulator's variances] with ``of`` degrees of freedom; 0 for the prior.
    """
    from scipy.special import gammaincinv

    most = 4.0 * RATIO + (0.5 * max(math.log(max(squares, 1e-300) / of), 0.0) if of else 0.0)
    log_r = most * (np.arange(NODES) + 0.5) / NODES
    log_p = -0.5 * (log_r / RATIO) ** 2 - of * log_r - 0.5 * squares * np.exp(-2.0 * log_r)
    shape = freedom / 2.0
    ends = np.log(gammaincinv(shape, [ROUNDING, 1.0 - ROUNDING]) / shape)
    at, rule = np.polynomial.legendre.leggauss(NODES)
    log_w = 0.5 * (ends[1] - ends[0]) * at + ends.mean()
    log_q = shape * (log_w - np.exp(log_w)) + np.log(rule)
    weights = np.exp(np.add.outer(log_p - log_p.max(), log_q - log_q.max())).ravel()
    pairs = np.exp(np.meshgrid(log_r, log_w, indexing="ij")).reshape(2, -1)
    return pairs[0], pairs[1], weights / weights.sum()
