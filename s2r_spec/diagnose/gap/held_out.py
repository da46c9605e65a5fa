"""The held-out gap: before and after the named effects are added to the simulator, and with all effects tuned.

Data: ρ of n real rollouts at T tests that no effect was estimated from, and ρ of simulated rollouts at these tests.
Unknown: the gap g = mean over the rollouts of |ρ_real − E ρ_sim|, for three simulators. Estimators:

    g:          E ρ_sim from SHOTS rollouts; a 95 % interval by a bootstrap over whole tests
    floor:      √(2/π) σ √(1 + 1/SHOTS), the gap of a perfect simulator; σ is the scatter of ρ from run to run
    background: 95 % quantile, over machines with θ_k ~ N(0, σ_bg²), of the mean |change of ρ|
    share:      (g_before − g_after) / (g_before − floor)

The gap is *material* if it exceeds floor + background, and what scatter alone makes in 1 of 20 cases. σ comes from
replicates of the machine if these have at least REPLICATED degrees of freedom, else from the simulator.

Units: those of ρ. Source: Efron & Tibshirani, *An Introduction to the Bootstrap* (1993), ch. 13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Values, lines
from s2r_spec.diagnose.gap import DRAWS, LEVEL
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulate import Bench, Job, Test, places_of, run_jobs
from s2r_spec.effects import catalogue_of
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Runs = Sequence[tuple[Test, Trace]]
Share = tuple[float, float, float]
"""Estimate, lower and upper end of a 95 % interval."""

SHOTS = 3
"""Budget: simulated rollouts of a held-out test. Doubled, the floor gets 7 % lower."""
MACHINES = 20
"""Budget: machines behind the background. Doubled, its quantile is steadier."""
SURELY = 1.645 * float(np.sqrt(np.pi / 2.0 - 1.0))
"""Definition: the mean of n |normal| numbers exceeds 1 + SURELY/√n times its expectation in 1 of 20 cases."""
REPLICATED = 5
"""Tolerance: degrees of freedom from which on replicates of the machine say how ρ scatters, to a third."""
ABOVE = 0.2
"""Tolerance: part of the floor by which a gap must exceed it for a share. Doubled, fewer small gaps have one."""
GONE = 0.8
"""Level: part of a material gap from which on it is closed. Higher, more laws that are off are *none of these*."""
CLOSED = 0.5
"""Level: part of a material gap that a named cause closes at least. Higher, fewer causes are named."""


@dataclass(frozen=True)
class Gap:
    """|ρ_real − E ρ_sim| over rollouts, in the unit of ρ.

    Attributes:
        mean: over the rollouts.
        low: of the mean's 95 % interval, rollouts of one test resampled together.
        high: of it.
        worst: largest over the tests, of the mean at each.
    """

    mean: float
    low: float
    high: float
    worst: float


@dataclass(frozen=True)
class HeldOut:
    """Held-out rollouts of one test.

    Attributes:
        params: the test.
        rollouts: real ones.
        before: ρ_real − E ρ_sim of the nominal simulator, mean over the rollouts.
        after: the same of the patched one; None when there is nothing to patch.
    """

    params: Mapping[str, float]
    rollouts: int
    before: float
    after: float | None


@dataclass(frozen=True)
class HeldOutGap:
    """The gap before and after.

    Attributes:
        rollouts: held-out real rollouts.
        unit: of ρ.
        before: gap of the nominal simulator.
        after: gap with the named effects; None when nothing is named.
        tuned: gap with the posterior mean of every effect.
        floor: gap of a perfect simulator.
        background: gap that a little of every effect makes at most, in 19 of 20 machines.
        share: part of the gap above the floor that the named effects close; None where it is hardly above.
        tuned_share: the same of ``tuned``.
        beyond: at most this part of all tests has a larger gap than any held-out one, with 95 % confidence.
        tests: the held-out ones, signed.
        seen: gap of the nominal simulator at the tests that were not held out; None without any.
    """

    rollouts: int
    unit: str
    before: Gap
    after: Gap | None
    tuned: Gap
    floor: float
    background: float
    share: Share | None
    tuned_share: Share | None
    beyond: float
    tests: tuple[HeldOut, ...]
    seen: Gap | None = None

    @property
    def at_most(self) -> float:
        """The mean gap of a machine with scatter and background alone, in 19 of 20 cases."""
        surely = self.floor * (1.0 + SURELY / float(np.sqrt(len(self.tests))))
        return max(self.floor + self.background, surely)

    @property
    def material(self) -> bool:
        """Whether the gap is more than scatter and background."""
        return self.before.mean > self.at_most

    @property
    def elsewhere(self) -> bool:
        """Whether only the tests that were not held out have a material gap."""
        return not self.material and self.seen is not None and self.seen.mean > self.at_most

    @property
    def best(self) -> Share | None:
        """The larger share of both improved simulators; None where the gap has no share."""
        return max(filter(None, (self.share, self.tuned_share)), default=None)

    @property
    def closed(self) -> bool:
        """Whether a material gap is nearly gone, and surely smaller."""
        return self.material and self.best is not None and self.best[0] >= GONE and self.best[1] > 0.0

    @property
    def explained(self) -> bool:
        """Whether the named effects alone close nearly all of a material gap, and surely some of it."""
        return self.material and self.share is not None and self.share[0] >= GONE and self.share[1] > 0.0

    def stays(self, least: float) -> bool:
        """Whether less than this part of a material gap is closed, and surely not all of it.

        An interval in which a patch helps, and as well doubles the gap, says nothing.
        """
        if not self.material or self.best is None:
            return False
        part, low, high = self.best
        surely = all(one[2] < 1.0 for one in (self.share, self.tuned_share) if one is not None)
        return part < least and surely and not low < -1.0 < 0.0 < high

    @property
    def short(self) -> bool:
        """Whether the named effects surely leave a part of a material gap."""
        return self.material and self.share is not None and self.share[2] < GONE

    @property
    def harmful(self) -> bool:
        """Whether the named effects make a material gap where there was none."""
        if self.after is None or self.material:
            return False
        return self.after.mean - self.before.mean > self.at_most

    @property
    def leaves_more(self) -> bool:
        """Whether the gap with the named effects is surely more than scatter and background."""
        return self.material and self.after is not None and self.after.low > self.at_most

    @property
    def better_tuned(self) -> bool:
        """Whether all effects tuned surely close more than the named ones."""
        return self.share is not None and self.tuned_share is not None and self.tuned_share[1] > self.share[2]

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object."""
        own = asdict(self) | {"material": self.material, "elsewhere": self.elsewhere}
        own["tests_with_a_larger_gap_at_most"] = own.pop("beyond")
        for name in ("share", "tuned_share"):
            own[name] = own[name] and dict(zip(("estimate", "low", "high"), own[name], strict=True))
        return own | {"tests": list(own["tests"])}


def held_out_gap(
    bench: Bench,
    held: Runs,
    seen: Runs,
    patch: Values,
    tuned: Values,
    seed: int,
    executor: Callable[[], Executor] | None = None,
) -> HeldOutGap | None:
    """Measure the gap at the held-out tests before and after; None where none was held out.

    Args:
        bench: the simulator and the spec.
        held: real rollouts from which nothing was estimated.
        seen: the real rollouts of tests from which the effects were estimated.
        patch: effect → parameter → value of the named effects; empty where nothing is named.
        tuned: the posterior mean of every effect.
        seed: of the simulations.
        executor: makes a pool for them; None runs them here.
    """
    if not held:
        return None
    tests, at = _distinct(held)
    shots = _simulated(bench, [{}, tuned, *([patch] if patch else [])], tests, SHOTS, seed, executor)
    rho, fell = shots[..., 0], (shots[0, ..., 1] > 0.0).any(axis=1)
    # A fall counts for so much that neither scatter nor background could be seen beside it.
    steady = np.logical_or(~fell, fell.all())
    # What a cause makes unsteady scatters more than the nominal simulator does.
    simulated = float(np.sqrt(np.maximum(*rho[[0, -1]].var(axis=2, ddof=1)))[steady].mean())
    machines = _simulated(bench, [{}, *background_machines(bench, seed)], tests, 1, seed, executor)[:, :, 0]
    early = {key_of(test) for test, trace in held if trace.failure is not None}
    # A fall of a random machine where the real one stands is no part of the real one's gap.
    ended = (machines[..., 1] > 0.0) & [key_of(test) not in early for test in tests]
    change = np.ma.masked_array(np.abs(machines[..., 0] - machines[0, :, 0]), ended | ended[0] | ~steady)[1:]
    real, others = ([bench.rho(trace, test) for test, trace in runs] for runs in (held, seen))
    elsewhere = None
    if seen:
        first, place = _distinct(seen)
        nominal = _simulated(bench, [{}], first, SHOTS, seed, executor)[0, ..., 0]
        elsewhere = gap(np.array(others) - nominal.mean(axis=1)[place], place)
    rows = zip((*held, *seen), (*real, *others), strict=True)
    return compared(
        np.array(real),
        [each.mean(axis=1)[at] for each in rho],
        [test for test, _ in held],
        scatter([(test, value) for (test, trace), value in rows if trace.failure is None], simulated),
        float(np.quantile(np.ma.filled(change.mean(axis=1), 0.0), 1.0 - LEVEL)),
        bench.spec.unit(bench.requirement),
        elsewhere,
    )


def _distinct(runs: Runs) -> tuple[list[Test], NDArray[np.intp]]:
    """Return the different tests, and the place of each run's test among them."""
    tests: list[Test] = [dict(key) for key in places_of([test for test, _ in runs])]
    return tests, np.array([tests.index(dict(test)) for test, _ in runs], dtype=np.intp)


def _simulated(
    bench: Bench,
    machines: Sequence[Values],
    tests: Sequence[Test],
    shots: int,
    seed: int,
    executor: Callable[[], Executor] | None,
) -> FloatArray:
    """Return (machines, tests, shots, 2) ρ and whether the rollout ended early; all with the same random numbers."""
    runs = tuple(
        (test, rollout_seed(seed, n, shot, Stream.GAP_SIM))
        for n, test in enumerate(tests)
        for shot in range(shots)
    )
    rows = run_jobs(bench, [Job(values, runs) for values in machines], executor)
    return np.array(rows).reshape(len(machines), len(tests), shots, 2)


def background_machines(bench: Bench, seed: int) -> list[Values]:
    """Return random machines with θ_k ~ N(0, σ_bg²), half-normal where the range has one side."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(Stream.GAP_SIM),)))
    machines: list[Values] = []
    parameters = lines(catalogue_of(bench.backend))
    for draws in BACKGROUND * rng.normal(size=(MACHINES, len(parameters))):
        values: dict[str, dict[str, float]] = {}
        for line, size in zip(parameters, draws.tolist(), strict=True):
            low, high = sorted((line.coordinate(line.low), line.coordinate(line.high)))
            inside = size if low < 0.0 < high else abs(size) if high > 0.0 else -abs(size)
            values.setdefault(line.effect, {})[line.parameter] = line.value(inside)
        machines.append(values)
    return machines


def scatter(runs: Sequence[tuple[Test, float]], simulated: float) -> float:
    """Return the standard deviation of ρ from run to run: of replicates where there are enough, else the simulator's.

    Args:
        runs: (test, ρ) of the machine, without rollouts that ended early.
        simulated: standard deviation of the simulator's ρ.
    """
    places = places_of([test for test, _ in runs]).values()
    several = [np.array([runs[place][1] for place in own]) for own in places if len(own) > 1]
    free = sum(len(own) - 1 for own in several)
    if free < REPLICATED:
        return simulated
    # The mean |difference| of two normal numbers is 2/√π of their standard deviation.
    apart = [float(np.abs(own[:, None] - own).sum()) / len(own) for own in several]
    return sum(apart) / free * float(np.sqrt(np.pi)) / 2.0


def gap(differences: FloatArray, groups: NDArray[np.intp]) -> Gap:
    """Return the mean of |differences| (n,) with an interval; ``groups`` (n,) says which share a test."""
    size = np.abs(differences)
    worst = max(abs(float(differences[groups == g].mean())) for g in np.unique(groups))
    return Gap(float(size.mean()), *_interval(_resampled(size[None], groups)[0]), worst)


def compared(
    real: FloatArray,
    simulated: Sequence[FloatArray],
    tests: Sequence[Test],
    deviation: float,
    background: float,
    unit: str,
    seen: Gap | None = None,
) -> HeldOutGap:
    """Compare held-out ρ with the mean ρ of the simulators at the same tests.

    Args:
        real: (n,) ρ of the held-out rollouts.
        simulated: (n,) mean ρ at each rollout's test of the nominal simulator, the tuned one and, where an effect is
            named, the patched one.
        tests: n of them.
        deviation: standard deviation of ρ from run to run.
        background: see :class:`HeldOutGap`.
        unit: of ρ.
        seen: see :class:`HeldOutGap`.
    """
    groups = np.array([tests.index(test) for test in tests], dtype=np.intp)
    left = [real - each for each in simulated]
    floor = deviation * float(np.sqrt(2.0 / np.pi * (1.0 + 1.0 / SHOTS)))
    before = gap(left[0], groups)

    def share(after: FloatArray) -> Share | None:
        if before.mean <= (1.0 + ABOVE) * floor:
            return None
        sizes = np.abs([left[0], after])
        b, a = np.column_stack([sizes.mean(axis=1), _resampled(sizes, groups)])
        closed = (b - a) / np.maximum(b - floor, ABOVE * floor + 1e-12)
        return (float(closed[0]), *_interval(closed[1:]))

    patched = left[2] if len(left) > 2 else None
    distinct = np.unique(groups)
    return HeldOutGap(
        rollouts=len(real),
        unit=unit,
        before=before,
        after=None if patched is None else gap(patched, groups),
        tuned=gap(left[1], groups),
        floor=floor,
        background=background,
        share=None if patched is None else share(patched),
        tuned_share=share(left[1]),
        beyond=float(1.0 - LEVEL ** (1.0 / len(distinct))),
        tests=tuple(
            HeldOut(
                dict(tests[g]),
                int((groups == g).sum()),
                float(left[0][groups == g].mean()),
                None if patched is None else float(patched[groups == g].mean()),
            )
            for g in distinct
        ),
        seen=seen,
    )


def _resampled(values: FloatArray, groups: NDArray[np.intp]) -> FloatArray:
    """Return (q, DRAWS) means of (q, n) values over whole tests; over rollouts if all are of one test."""
    rng = np.random.default_rng(np.random.SeedSequence(0))
    tests = np.unique(groups, return_inverse=True)[1] if np.ptp(groups) else np.arange(groups.size)
    member = tests == np.arange(tests.max() + 1)[:, None]
    picks = rng.integers(len(member), size=(DRAWS, len(member)))
    return np.asarray((values @ member.T)[:, picks].sum(axis=2) / member.sum(axis=1)[picks].sum(axis=1))


def _interval(draws: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(draws, [LEVEL / 2, 1.0 - LEVEL / 2])
    return float(low), float(high)
