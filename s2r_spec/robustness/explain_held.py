"""Explanation of ρ of channels with messages of their own: the instant and the predicate that decide it.

The way down from the requirement is that of :mod:`s2r_spec.robustness.deciding`, on curves: a window is searched at its
breakpoints and within the pieces between them. A held value is shown at the message that set it, or at the begin of
the window if that comes later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.at_start import bounds_at_start, curves_of, infimum_over
from s2r_spec.robustness.bounds import RhoBounds
from s2r_spec.robustness.curve import Curve
from s2r_spec.robustness.deciding import Descent, Step
from s2r_spec.robustness.evaluate import Walk, up_to
from s2r_spec.robustness.explain import (
    Decided,
    Explanation,
    Observed,
    make_explanation,
    observe,
    observe_signals,
    way_down,
)
from s2r_spec.robustness.held import Courses, HeldValues, signals_of
from s2r_spec.robustness.silence import HeldBounds
from s2r_spec.robustness.ticks import Reach

Span = tuple[float, float]

SHOWN = 5
"""Budget: runs of a predicate whose times are printed to the resolution of the stamps around them."""
_INSIDE = 1e-6
"""Tolerance: distance from the end of a piece to the instant that stands for its limit there [lengths of the piece]."""


@dataclass(frozen=True, kw_only=True)
class _HeldStep(Step):
    """A sub-formula on the way down at a time [s], and (k, 2) times at which the verdict depends on it, from and to."""

    time: float
    runs: FloatArray


@dataclass(frozen=True)
class HeldExplainer(Descent[_HeldStep]):
    """Explains ρ of one requirement.

    Args:
        bounds: the bounds of predicates, whose first instant is that of the requirement.
        start: that instant on the clock of the trace [s].
        worse: whether ρ is the lower bound; else the upper one.
    """

    bounds: HeldBounds
    start: float
    worse: bool

    @cached_property
    def walk(self) -> Walk[RhoBounds[Curve]]:
        """The walk over bounds on curves."""
        return self.bounds.walk()

    @property
    def courses(self) -> Courses:
        """The signals; of several values with one stamp the first one."""
        return self.bounds.courses

    def explain(self, formula: f.Formula, requirement: str, unit: str) -> Explanation:
        """Return the explanation of a formula."""
        first = _HeldStep(node=formula, time=0.0, runs=np.zeros((1, 2)))
        rho, steps = self.rho(formula, first, 1.0), list(self.steps(first))
        parts = way_down((step.node, self.start + step.time, rho / step.factor) for step in steps)
        last = steps[-1]
        vacuous = next((a.node for a, b in pairwise(steps) if b.vacuous), None)
        unneeded = vacuous.right.span.text if isinstance(vacuous, f.Implication) else ""
        at = parts[-1].time
        decided = Decided(last.node, last.factor, self._instants_near([at]), unneeded=unneeded)
        if isinstance(last.node, f.Comparison):
            runs = self._runs(last)
            decided = replace(
                decided,
                times=self._instants_near([at, *(time for run in runs[:SHOWN] for time in run)]),
                runs=runs,
                sides=tuple(self._observe(side, last.time) for side in (last.node.left, last.node.right)),
                signals=observe_signals(last.node, partial(self._read, time=last.time)),
            )
        return make_explanation(requirement, unit, rho, parts, decided)

    def curve(self, node: f.Formula, factor: float) -> Curve:
        """Return the curve of a node: the bound that ρ of the requirement depends on."""
        bounds = curves_of(node, self.walk)
        return bounds.lower if (factor > 0) == self.worse else bounds.upper

    def rho(self, node: f.Formula, step: _HeldStep, factor: float) -> float:
        """Return ρ of a node at the instant of a step."""
        if step.time == 0.0:
            lower, upper = bounds_at_start(node, self.walk, self.courses.snap)
            return lower if (factor > 0) == self.worse else upper
        return float(self.curve(node, factor).values(np.array([step.time]), self.courses.snap)[0])

    # -- the way down ------------------------------------------------------------------------------------------------

    def earlier(self, step: _HeldStep) -> _HeldStep | None:
        """Return the step just before; None at the begin."""
        before = step.time - 4 * self.courses.snap
        return None if before < 0.0 else replace(step, time=before)

    def _window(self, interval: f.Interval, step: _HeldStep, past: bool) -> Span:
        """Return the times of a window of one instant, cut at the ends of the trace."""
        reach = Reach.of(interval, past)
        return max(step.time + reach.low, 0.0), min(step.time + reach.high, self.courses.end)

    def _spread(self, interval: f.Interval, step: _HeldStep, past: bool) -> FloatArray:
        """Return the times that the windows of a step's instants reach, as one run."""
        reach = Reach.of(interval, past)
        begin, end = step.runs[0, 0] + reach.low, step.runs[-1, 1] + reach.high
        return np.array([[max(begin, 0.0), min(end, self.courses.end)]])

    def _restrict(self, curve: Curve, holds: bool, runs: FloatArray) -> FloatArray:
        """Return the parts of runs at which a formula holds, or does not; (k, 2) times, k ≥ 1."""
        agrees = np.empty(2 * curve.times.size - 1, dtype=bool)
        agrees[::2] = (curve.at > 0) == holds
        agrees[1::2] = ((curve.right > 0) == holds) | ((curve.left > 0) == holds)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], agrees, [False]))))
        first, stop = edges[::2], edges[1::2]
        own = np.stack(
            (curve.times[first // 2], curve.times[np.minimum(stop // 2, curve.times.size - 1)]), axis=1
        )
        both = [np.clip(own[(own[:, 1] >= begin) & (own[:, 0] <= end)], begin, end) for begin, end in runs]
        agreeing = np.concatenate(both)
        return agreeing if len(agreeing) else runs

    def extreme(
        self, node: f.Formula, step: _HeldStep, interval: f.Interval, past: bool, least: bool
    ) -> _HeldStep | None:
        """Return the step to the least, or the greatest, ρ of a node in a window; None in an empty one."""
        low, high = self._window(interval, step, past)
        if isinstance(node, f.Junction) and (node.operator == "and") == least:
            # One part after the other: the curve of all has the stamps of all topics.
            within = replace(interval, low=low, high=high)
            over = [
                infimum_over(x if least else -x, within, self.courses.snap)
                for x in (self.curve(part, step.factor) for part in node.operands)
            ]
            best = int(np.argmin(over))
            return self.extreme(node.operands[best], step, interval, past, least)
        curve = self.curve(node, step.factor)
        time = self._place(curve if least else -curve, low, high, past)
        if time is None:
            return None
        rho = float(curve.values(np.array([time]), self.courses.snap)[0])
        runs = self._restrict(curve, rho > 0, self._spread(interval, step, past))
        return replace(step, node=node, time=time, runs=runs)

    def _place(self, x: Curve, low: float, high: float, past: bool) -> float | None:
        """Return the instant in a window at which a curve is least, the nearest of several; None in no window.

        An infimum that is a limit has an instant close to it.
        """
        snap = self.courses.snap
        if low > high + snap:
            return None
        first, stop = np.searchsorted(x.times, low - snap), np.searchsorted(x.times, high + snap, "right")
        times, values = [np.clip(x.times[first:stop], low, high)], [x.at[first:stop]]
        if x.right.size:
            begin = max(int(np.searchsorted(x.times, low + snap, side="right")) - 1, 0)
            final = min(int(np.searchsorted(x.times, high - snap)), x.right.size)
            starts, ends = x.times[begin:final], x.times[begin + 1 : final + 1]
            inside = _INSIDE * (ends - starts)
            times += [np.clip(starts + inside, low, high), np.clip(ends - inside, low, high)]
            values += [x.right[begin:final], x.left[begin:final]]
        known = [(float(part.min()), part, at) for part, at in zip(values, times, strict=True) if part.size]
        least = min(value for value, _, _ in known)
        last = -1 if past else 0
        places = [at[np.flatnonzero(part == least)[last]] for value, part, at in known if value == least]
        return float(max(places) if past else min(places))

    def _instants(
        self, curves: list[Curve], low: float, high: float, interval: f.Interval, past: bool
    ) -> FloatArray:
        """Return the breakpoints of curves in a window, and instants within the pieces; nearest first."""
        snap = self.courses.snap
        if low > high + snap:
            return np.zeros(0)
        stamps = np.unique(np.concatenate([x.times for x in curves]))
        inner = stamps[(stamps > low + snap) & (stamps < high - snap)]
        ends = np.concatenate(([low], inner, [high]))
        width = np.diff(ends)
        long = width > snap
        within = np.concatenate([(ends[:-1] + _INSIDE * width)[long], (ends[1:] - _INSIDE * width)[long]])
        near, far = (high, low) if past else (low, high)
        borders = [near] * interval.low_closed + [far] * interval.high_closed
        times = np.unique(np.concatenate([inner, within, borders]))
        return times[::-1] if past else times

    def until(self, node: f.Until, step: _HeldStep) -> _HeldStep | None:
        """Return the step to the side of an until that decides; None in an empty window."""
        sign = -1.0 if node.operator == "release" else 1.0  # release is the dual of until
        past = node.operator == "since"
        way = replace(up_to(node.interval), span=node.interval.span)
        low, high = self._window(way, step, past)
        left, right = self.curve(node.left, step.factor), self.curve(node.right, step.factor)
        times = self._instants([left, right], low, high, way, past)
        snap = self.courses.snap
        holds, goal = sign * left.values(times, snap), sign * right.values(times, snap)
        if self.walk.witness == "closed":
            goal = np.minimum(holds, goal)
        guard = np.minimum.accumulate(np.concatenate(([np.inf], holds[:-1])))
        first = np.abs(times - step.time) >= node.interval.low - snap
        rho = np.where(first, np.minimum(guard, goal), -np.inf)
        spread = self._spread(way, step, past)
        if node.operator == "unless":
            stays = self.extreme(node.left, step, way, False, least=True)
            if stays and (not rho.size or self.rho(stays.node, stays, step.factor) >= rho.max()):
                return stays
        if not rho.size or math.isinf(rho.max()):
            return None
        best = int(np.argmax(rho))
        held = holds[: best + (self.walk.witness == "closed")]
        if held.size and held.min() < goal[best]:
            return replace(step, node=node.left, time=float(times[np.argmin(held)]), runs=spread)
        return replace(step, node=node.right, time=float(times[best]), runs=spread)

    def _instants_near(self, times: list[float]) -> FloatArray:
        """Return the begin, times on the trace's clock, and the stamps of all signals around them."""
        near = [np.array([0.0]), np.array(times) - self.start]
        for course in self.courses.signals.values():
            for time in near[1]:
                place = int(np.searchsorted(course.times, time))
                near.append(course.times[max(place - 2, 0) : place + 3])
        stamps = np.unique(np.concatenate(near))
        return stamps[stamps >= 0.0] + self.start

    # -- what is shown -----------------------------------------------------------------------------------------------

    def _runs(self, step: _HeldStep) -> tuple[Span, ...]:
        """Return (from, to) times in the window at which the predicate is what decides: [s] on the trace's clock."""
        holds = self.rho(step.node, step, step.factor) > 0
        runs = self._restrict(self.curve(step.node, step.factor), holds, step.runs)
        return tuple((self.start + float(begin), self.start + float(end)) for begin, end in runs)

    def _observe(self, node: f.Value, time: float) -> Observed:
        values = HeldValues.at_messages(self.courses, signals_of(node))
        number = float(values(node).values(np.array([time]), self.courses.snap)[0])
        return observe(node, number)

    def _read(self, node: f.SignalValue | f.ParamValue, time: float) -> FloatArray:
        if isinstance(node, f.ParamValue):
            return self.courses.params[node.name][:, 0]
        rows = self.courses.signals[node.name].at(np.array([time]))[:, 0]
        return rows if node.index is None else rows[[node.index]]
