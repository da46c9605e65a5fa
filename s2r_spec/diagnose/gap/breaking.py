"""At which size each effect alone would break the requirement, on the machine as it was found.

Data, at each of T recorded tests t: m_t, the mean ρ of the real rollouts; and f_tk(x), the mean ρ of simulated runs
with parameter k alone at the sizes x of the library, nominal among them, with the same seeds at every size, at the test
of the library that is nearest in the unit cube. Unknown: the size nearest to the estimate x̂_k, on either side, at which
the *limit state*

    g_k(x) = min_t ρ_tk(x),   ρ_tk(x) = m_t + f_tk(x) − f_tk(x̂_k)

changes sign. So contributions of effects to ρ are assumed to add, as the responses of the library do
(:mod:`.simulator.response`): that of k is simulated, and all the others are in m_t. An early end counts with the ρ that
the spec declares for it, and breaks the requirement if it declares none.

Estimator: on the way from x̂_k outwards, the last simulated size before the sign changes and the first one after it;
x̂_k itself counts as simulated, since the machine was measured there. Between the two lies the crossing. Its place is
that of the monotone cubic through f_tk (:mod:`.simulator.curve`), where the ρ of the test that decides is monotone from
x̂_k to the size after the crossing and no run there ended early; else only the interval is known. Nothing is said beyond
the simulated sizes. The interval is one of the simulated sizes, not of a probability: with few rollouts of a test, m_t
is off by their scatter. A parameter that only says how another one acts has no size that breaks anything alone, and an
angle of any value has no end.

Units: coordinates in typical sizes, values in the parameter's unit, ρ in its own. Shapes: T tests, K parameters.
Source: Ditlevsen & Madsen, *Structural Reliability Methods* (2007), section 1 (limit state; here one parameter at a
time).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_values import Point, Shown
from s2r_spec.diagnose.gap.surface import in_cube
from s2r_spec.diagnose.inference.estimates import EffectEstimate
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.diagnose.simulator.bench import Bench, TestRun, places_of
from s2r_spec.diagnose.simulator.curve import ResponseCurve
from s2r_spec.diagnose.simulator.response import ResponseLibrary, RobustnessCurve
from s2r_spec.space import Key, Space, key_of

SAME = 1e-9
"""Tolerance: sizes that differ by less are one size, in typical sizes."""


@dataclass(frozen=True)
class Crossing(Shown):
    """Where ρ changes sign on one side of the size that was found, in the parameter's unit.

    Attributes:
        axis: the parameter.
        before, after: the last simulated coordinate before the sign changes, and the first after it.
        at: the coordinate of the crossing; None where only its interval is known.
        test: the test that decides.
    """

    axis: EffectAxis
    before: float
    after: float
    at: float | None
    test: Mapping[str, float]

    JSON = "estimate low high test"

    @property
    def estimate(self) -> float | None:
        """The size at which ρ is 0; null where only its interval is known."""
        return None if self.at is None else self.axis.value(self.at)

    @property
    def low(self) -> float:
        """The lower end of the interval between two simulated sizes."""
        return self.axis.value(min(self.before, self.after))

    @property
    def high(self) -> float:
        """The upper end of the interval."""
        return self.axis.value(max(self.before, self.after))


@dataclass(frozen=True)
class BreakingSize(Shown):
    """At which sizes of one parameter, all else as it was found, ρ changes sign at the worst test.

    Attributes:
        effect: name.
        parameter: name.
        axis: the parameter.
        found: coordinate of its estimate.
        reach: the least and the largest coordinate that were simulated, the estimate among them.
        below: where ρ changes sign below the estimate; None where it does not.
        above: where ρ changes sign above the estimate; None where it does not.
    """

    axis: EffectAxis
    found: float
    reach: tuple[float, float]
    below: Crossing | None
    above: Crossing | None

    JSON = "effect=axis.effect parameter=axis.parameter unit=axis.unit estimate simulated below above"

    @property
    def name(self) -> str:
        """``payload.mass``."""
        return self.axis.name

    @property
    def estimate(self) -> float:
        """The size that was found, in the unit."""
        return self.axis.value(self.found)

    @property
    def simulated(self) -> tuple[float, float]:
        """The ends of the sizes that were looked at."""
        low, high = self.reach
        return self.axis.value(low), self.axis.value(high)

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """The crossings, the lower one first."""
        return tuple(one for one in (self.below, self.above) if one is not None)

    @property
    def distance(self) -> float:
        """Distance from the estimate to the nearest crossing, in typical sizes; infinite without one."""
        ends = [one.after if one.at is None else one.at for one in self.crossings]
        return min((abs(end - self.found) for end in ends), default=np.inf)


@dataclass(frozen=True)
class Breaking(Shown):
    """How far the machine, as it was found, is from breaking the requirement, or from meeting it.

    Attributes:
        rho: mean ρ of the real rollouts at the worst recorded test.
        unit: the unit of ρ.
        test: the worst test.
        sizes: one for each parameter that acts alone, nearest crossing first.
    """

    rho: float
    unit: str
    test: Mapping[str, float]
    sizes: tuple[BreakingSize, ...]

    JSON = "holds rho unit test sizes"

    @property
    def holds(self) -> bool:
        """Whether the mean ρ is at least 0 at every test: a crossing breaks the requirement, else it restores it."""
        return self.rho >= 0.0

    @property
    def crossed(self) -> tuple[BreakingSize, ...]:
        """The parameters of which a simulated size changes the sign of ρ."""
        return tuple(one for one in self.sizes if one.crossings)

    @property
    def by_name(self) -> dict[str, BreakingSize]:
        """``payload.mass`` → its sizes."""
        return {one.name: one for one in self.sizes}


@dataclass(frozen=True)
class _Limit:
    """ρ over one parameter at one test: m_t and f_tk, from the estimate on."""

    test: Point
    real: float
    curve: RobustnessCurve
    cubic: ResponseCurve
    found: float

    @classmethod
    def of(cls, test: Point, real: float, curve: RobustnessCurve, found: float) -> _Limit:
        finite = np.isfinite(curve.rho)
        cubic = ResponseCurve(curve.coordinates[finite], curve.rho[finite, None])
        return cls(test, real, curve, cubic, found)

    def rho(self, at: float) -> float:
        """Return ρ at a coordinate; −∞ where the simulator ended early without a ρ."""
        place = np.flatnonzero(np.abs(self.curve.coordinates - at) < SAME)
        if place.size and not np.isfinite(self.curve.rho[place[0]]):
            return -np.inf
        return float(self.real + self.cubic.at(at)[0] - self.cubic.at(self.found)[0])

    def is_smooth(self, until: float) -> bool:
        """Return whether no run ended early, and ρ is monotone, from the estimate to a coordinate."""
        low, high = min(self.found, until) - SAME, max(self.found, until) + SAME
        passed = (self.curve.coordinates > low) & (self.curve.coordinates < high)
        points = [at for at in self.curve.coordinates[passed].tolist() if abs(at - self.found) > SAME]
        steps = np.diff([self.rho(at) for at in sorted([self.found, *points])])
        return not self.curve.ended[passed].any() and bool((steps <= 0.0).all() or (steps >= 0.0).all())


def breaking_sizes(
    bench: Bench, library: ResponseLibrary, rollouts: Sequence[TestRun], effects: Sequence[EffectEstimate]
) -> Breaking | None:
    """Return at which sizes the requirement breaks; None without real rollouts, or if no test of the library has ρ."""
    if not rollouts:
        return None
    places = places_of([test for test, _ in rollouts])
    curves = nearest_curves(bench, library, places)
    if not curves:
        return None
    rho = np.array([bench.rho(trace, test) for test, trace in rollouts])
    real = [(dict(key), float(rho[own].mean())) for key, own in places.items()]
    found = {f"{one.effect}.{each.parameter}": each.size for one in effects for each in one.parameters}
    sizes = [
        _sizes(
            axis,
            [_Limit.of(*one, own[k], found[axis.name]) for one, own in zip(real, curves, strict=True)],
        )
        for k, axis in enumerate(library.parameters)
        if not axis.base and not axis.is_turn and axis.name in found
    ]
    worst, lowest = min(real, key=lambda one: one[1])
    unit = bench.spec.unit(bench.requirement)
    return Breaking(lowest, unit, worst, tuple(sorted(sizes, key=lambda one: one.distance)))


def nearest_curves(
    bench: Bench, library: ResponseLibrary, tests: Collection[Key]
) -> list[Mapping[int, RobustnessCurve]]:
    """Return the curves of ρ at the test of the library that is nearest to each test; none if no test of it has ρ."""
    known = {
        key_of(test): one.robustness
        for one in library.responses
        if one.robustness and (test := bench.matched.to_spec(one.experiment.values)) is not None
    }
    if not known:
        return []
    space, curves = bench.spec.space, [*known.values()]
    away = np.linalg.norm(_in_cube(space, tests)[:, None] - _in_cube(space, known), axis=2)
    return [curves[nearest] for nearest in away.argmin(axis=1)]


def _in_cube(space: Space, tests: Iterable[Key]) -> FloatArray:
    """Return (T, dim) the places of tests in the unit cube."""
    return in_cube(space, np.array([space.vector(dict(key)) for key in tests]))


def _sizes(axis: EffectAxis, limits: Sequence[_Limit]) -> BreakingSize:
    found = limits[0].found
    points = np.unique(np.concatenate([one.curve.coordinates for one in limits]))
    low, high = (points[points < found - SAME][::-1], points[points > found + SAME])
    crossings = [_crossing(axis, limits, side.tolist()) for side in (low, high)]
    reach = min(found, float(points[0])), max(found, float(points[-1]))
    return BreakingSize(axis, found, reach, *crossings)


def _crossing(axis: EffectAxis, limits: Sequence[_Limit], outwards: Sequence[float]) -> Crossing | None:
    """Return the first change of sign of the limit state on the way outwards; None without one."""
    from scipy.optimize import brentq

    def state(at: float) -> float:
        return min(one.rho(at) for one in limits)

    found = limits[0].found
    held = min(one.real for one in limits) >= 0.0
    before = found
    for after in outwards:
        if (state(after) >= 0.0) != held:
            break
        before = after
    else:
        return None
    at = brentq(state, before, after) if np.isfinite([state(before), state(after)]).all() else None
    decides = min(limits, key=lambda one: one.rho(after if at is None else at))
    if at is not None and not decides.is_smooth(after):
        at = None
    return Crossing(axis, before, after, at, decides.test)
