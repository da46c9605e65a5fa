"""The held-out gap: before and after the named effects are added to the simulator, and with all effects tuned.

Data: ρ of n real rollouts at T tests that no effect was estimated from, and ρ of simulated rollouts at these tests.
Unknown: the gap g = mean over the rollouts of |ρ_real − E ρ_sim|, for three simulators. Estimators:

    g:          E ρ_sim from SHOTS rollouts; a 95 % interval by a bootstrap over whole tests
    floor:      √(2/π) σ √(1 + 1/SHOTS), the gap of a perfect simulator; σ is the scatter of ρ from run to run
    background: 95 % quantile, over machines with θ_k ~ N(0, σ_bg²), of the mean |change of ρ|
    share:      (g_before − g_after) / (g_before − floor)

The gap is *material* if it exceeds floor + background, and what scatter alone makes in 1 of 20 cases. σ comes from
replicates of the machine if these have at least FEWEST degrees of freedom, else from the simulator.

What closes is the gap *where it shows*: at all held-out tests if it is material there, else at all other tests if it is
material there, else at the single tests at which it matters (:mod:`.materiality`). It is *closed* if its share over the
rollouts of these tests is at least GONE, and surely above 0. It surely *stays* only where it shows at FEWEST tests.

Units: those of ρ. Source: Efron & Tibshirani, *An Introduction to the Bootstrap* (1993), ch. 13.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend.effects import catalogue_of
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_types import Count
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.gap import FEWEST, LEVEL, SHOTS
from s2r_spec.diagnose.gap.materiality import Materiality, mean_difference
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.gap.shares import GONE, Gap, Share, gap, share_closed
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulator.axes import Values, effect_axes
from s2r_spec.diagnose.simulator.bench import Bench, Test, TestRun, places_of, table
from s2r_spec.diagnose.simulator.response import values_at
from s2r_spec.runs.seeds import SeedStream
from s2r_spec.space import key_of

CLOSED = 0.5
"""Level: part of a material gap that a named cause closes at least. Higher, fewer causes are named."""


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
class ClosedThere:
    """How much of the gap is closed at the tests at which it shows, if it is not material at the held-out ones.

    Attributes:
        tests: number of these tests.
        share: part of the gap above the floor that the named effects close; None without such a gap, or a name.
        tuned_share: the same share for the tuned simulator.
    """

    tests: Count
    share: Share | None
    tuned_share: Share | None


@dataclass(frozen=True)
class HeldOutGap(Shown):
    """The gap on held-out rollouts, before and after the named effects were added to the simulator.

    Attributes:
        rollouts: number of held-out real rollouts.
        unit: the unit of ρ.
        before: the gap of the nominal simulator.
        after: the gap with the named effects; None if nothing is named.
        tuned: the gap with the posterior mean of every effect.
        floor: the gap due to scatter alone.
        background: the largest gap that small amounts of all effects make in 19 of 20 machines.
        share: part of the gap above the floor that the named effects close.
        tuned_share: the same share for the tuned simulator.
        tests: the signed gap of each held-out test.
        seen: the gap of the nominal simulator at the tests that were not held out.
        closed_there: both shares where the gap shows; None if that is at all held-out tests, or nowhere.
    """

    rollouts: Count
    unit: str
    before: Gap
    after: Gap | None
    tuned: Gap
    floor: float
    background: float
    share: Share | None
    tuned_share: Share | None
    tests: tuple[HeldOut, ...]
    seen: Gap | None = None
    closed_there: ClosedThere | None = None

    JSON = (
        "rollouts unit before after tuned floor background share tuned_share closed_there tests seen material "
        "elsewhere"
    )

    @property
    def at_most(self) -> float:
        """The mean gap of a machine with scatter and background alone, in 19 of 20 cases."""
        # The mean of n |normal| numbers exceeds its expectation by more than this in so many cases.
        surely = NormalDist().inv_cdf(1.0 - LEVEL) * math.sqrt((math.pi / 2.0 - 1.0) / len(self.tests))
        return max(self.floor + self.background, self.floor * (1.0 + surely))

    @property
    def material(self) -> bool:
        """Whether the gap exceeds scatter and background."""
        return self.before.mean > self.at_most

    @property
    def elsewhere(self) -> bool:
        """Whether only the tests that were not held out have a material gap."""
        return not self.material and self.seen is not None and self.seen.mean > self.at_most

    @property
    def shares(self) -> tuple[Share | None, Share | None]:
        """The part that the named effects close where the gap shows, and that of all effects tuned."""
        if self.material:
            return self.share, self.tuned_share
        there = self.closed_there
        return (None, None) if there is None else (there.share, there.tuned_share)

    @property
    def closed(self) -> bool:
        """Whether the better of both improved simulators closes the gap where it shows."""
        return any(one is not None and one.gone for one in self.shares)

    @property
    def explained(self) -> bool:
        """Whether the named effects alone close the gap where it shows."""
        return self.shares[0] is not None and self.shares[0].gone

    @property
    def _sure(self) -> bool:
        """Whether the gap shows at enough tests to say that something of it surely stays."""
        there = self.closed_there
        return self.material or (there is not None and there.tests >= FEWEST)

    def stays(self, least: float) -> bool:
        """Whether less than this part of the gap is closed where it shows, and surely not all of it.

        An interval in which a patch helps, and as well doubles the gap, says nothing.
        """
        shares = [one for one in self.shares if one is not None]
        if not self._sure or not shares:
            return False
        best = max(shares)
        surely = all(one.high < 1.0 for one in shares)
        return best.estimate < least and surely and not best.low < -1.0 < 0.0 < best.high

    @property
    def short(self) -> bool:
        """Whether the named effects surely leave a part of the gap where it shows."""
        share = self.shares[0]
        return self._sure and share is not None and share.high < GONE

    @property
    def harmful(self) -> bool:
        """Whether the named effects make a material gap where there was none."""
        worse = 0.0 if self.after is None else self.after.mean - self.before.mean
        return not self.material and worse > self.at_most

    @property
    def leaves_more(self) -> bool:
        """Whether the gap with the named effects is surely more than scatter and background."""
        return self.material and self.after is not None and self.after.low > self.at_most

    @property
    def better_tuned(self) -> bool:
        """Whether all effects tuned surely close more than the named ones."""
        return (
            self.share is not None and self.tuned_share is not None and self.tuned_share.low > self.share.high
        )


def held_out_gap(
    bench: Bench,
    held: Sequence[TestRun],
    seen: Sequence[TestRun],
    patch: Values,
    tuned: Values,
    nominal: Nominal,
    matters: Materiality | None = None,
) -> HeldOutGap | None:
    """Measure the gap at the held-out tests before and after; None where none was held out.

    The other tests are ``seen``. ``patch`` has the values of the named effects, ``tuned`` the posterior mean of every
    one. ``nominal`` is the simulator at all of these tests. ``matters`` says at which single ones the gap does.
    """
    if not held:
        return None
    real, others = (np.array([bench.rho(trace, test) for test, trace in runs]) for runs in (held, seen))
    tests, at = _distinct_tests([test for test, _ in held])
    machines = [tuned, *([patch] if patch or nominal.files else [])]
    own = _rho_of(bench, machines, tests, nominal)
    before = nominal.before
    first = np.array([before.rho[key_of(test)][:SHOTS] for test in tests])
    rho = np.concatenate([first[None], own])
    fell = np.array([before.ended[key_of(test)][:SHOTS] for test in tests])
    # A fall counts for so much that neither scatter nor background could be seen beside it.
    steady = ~fell.any(axis=1) | fell.any(axis=1).all()
    # What a cause makes unsteady scatters more than the nominal simulator does.
    simulated = float(np.sqrt(np.maximum(*rho[[0, -1]].var(axis=2, ddof=1)))[steady].mean())
    random, ended = table(bench, background_machines(bench, nominal.seed), nominal.first(tests))
    early = {key_of(test) for test, trace in held if trace.failure is not None}
    # A fall of a random machine where the real one stands is no part of the real one's gap.
    ended = (ended > 0.0) & [key_of(test) not in early for test in tests]
    alone = np.array([nominal.rho[key_of(test)][0] for test in tests])
    change = np.ma.masked_array(np.abs(random - alone), ended | fell[:, 0] | ~steady).mean(axis=1)
    elsewhere = None
    if seen:
        _, place = _distinct_tests([test for test, _ in seen])
        means = [before.rho[key_of(test)].mean() for test, _ in seen]
        elsewhere = gap(others - means, place)
    rows = list(zip((*held, *seen), (*real.tolist(), *others.tolist()), strict=True))
    found = compare(
        real,
        [each.mean(axis=1)[at] for each in rho],
        [test for test, _ in held],
        scatter([(test, value) for (test, trace), value in rows if trace.failure is None], simulated),
        float(np.quantile(np.ma.filled(change, 0.0), 1.0 - LEVEL)),
        bench.spec.unit(bench.requirement),
        elsewhere,
    )
    places = () if matters is None else (at.params for at in matters.places)
    where = {key_of(test) for test in ([test for test, _ in seen] if found.elsewhere else places)}
    shown = [(test, value) for (test, _), value in rows if key_of(test) in where]
    if found.material or not shown:
        return found
    return replace(found, closed_there=_closed_there(bench, shown, machines, nominal, found.floor))


def _rho_of(bench: Bench, machines: Sequence[Values], tests: Sequence[Test], nominal: Nominal) -> FloatArray:
    """Return (machines, tests, SHOTS) ρ of modified simulators, with the seeds of the nominal one."""
    rho, _ = table(bench, machines, nominal.first(tests, SHOTS))
    return np.asarray(rho.reshape(-1, len(tests), SHOTS))


def _closed_there(
    bench: Bench,
    runs: Sequence[tuple[Test, float]],
    machines: Sequence[Values],
    nominal: Nominal,
    floor: float,
) -> ClosedThere:
    """Return what the tuned simulator, and the patched one if there is one, close at tests with their real ρ."""
    tests, at = _distinct_tests([test for test, _ in runs])
    first = np.array([nominal.before.rho[key_of(test)][:SHOTS] for test in tests])
    rho = np.concatenate([first[None], _rho_of(bench, machines, tests, nominal)]).mean(axis=2)[:, at]
    before, *after = np.array([value for _, value in runs]) - rho
    tuned, *named = (share_closed(before, one, at, floor) for one in after)
    return ClosedThere(len(tests), named[0] if named else None, tuned)


def _distinct_tests(tests: Sequence[Test]) -> tuple[list[Test], NDArray[np.intp]]:
    places = places_of(tests)
    number = np.empty(len(tests), dtype=np.intp)
    for n, own in enumerate(places.values()):
        number[own] = n
    return [dict(key) for key in places], number


def background_machines(bench: Bench, seed: int) -> list[Values]:
    """Return random machines with θ_k ~ N(0, σ_bg²): so many that on average one exceeds the quantile."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(SeedStream.GAP_SIM),)))
    machines: list[Values] = []
    parameters = effect_axes(catalogue_of(bench.backend))
    for draws in BACKGROUND * rng.normal(size=(round(1.0 / LEVEL), len(parameters))):
        low, high = np.array([axis.ends for axis in parameters]).reshape(-1, 2).T
        one_side = np.where(high > 0.0, np.abs(draws), -np.abs(draws))
        machines.append(values_at(parameters, np.where((low < 0.0) & (high > 0.0), draws, one_side)))
    return machines


def scatter(runs: Sequence[tuple[Test, float]], simulated: float) -> float:
    """Return the standard deviation of ρ from run to run: of replicates among (test, ρ) of whole real rollouts.

    Where these are too few, it is that of ``simulated`` ones.
    """
    places = places_of([test for test, _ in runs]).values()
    several = [np.array([runs[place][1] for place in own]) for own in places if len(own) > 1]
    free = [len(own) - 1 for own in several]
    if sum(free) < FEWEST:
        return simulated
    return (
        float(np.average([mean_difference(own) for own in several], weights=free)) * math.sqrt(math.pi) / 2.0
    )


def compare(
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
    distinct, groups = _distinct_tests(tests)
    nominal, tuned, *patched = (real - each for each in simulated)
    floor = deviation * math.sqrt(2.0 / math.pi * (1.0 + 1.0 / SHOTS))
    counts = np.bincount(groups).tolist()
    signed = [(np.bincount(groups, each) / counts).tolist() for each in (nominal, *patched)]
    after = signed[1] if patched else [None] * len(distinct)
    return HeldOutGap(
        rollouts=len(real),
        unit=unit,
        before=gap(nominal, groups),
        after=gap(patched[0], groups) if patched else None,
        tuned=gap(tuned, groups),
        floor=floor,
        background=background,
        share=share_closed(nominal, patched[0], groups, floor) if patched else None,
        tuned_share=share_closed(nominal, tuned, groups, floor),
        tests=tuple(HeldOut(*each) for each in zip(distinct, counts, signed[0], after, strict=True)),
        seen=seen,
    )
