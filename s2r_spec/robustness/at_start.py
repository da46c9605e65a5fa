"""ρ at the first instant of curves, without the curve of ρ at every other one.

Model: min and max are associative, so that an ``always`` over a conjunction is the least of the parts, each over the
same window, and an ``always`` within an ``always`` has the sum of both windows. So most requirements need one extreme
of each predicate, and no curve over all stamps of all signals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_spec.lang import formula as f
from s2r_spec.robustness.bounds import RhoBounds
from s2r_spec.robustness.curve import Curve
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.ties import rescale_number

Pair = tuple[float, float]


def curves_of(node: f.Formula, walk: Walk[RhoBounds[Curve]]) -> RhoBounds[Curve]:
    """Return the curves of a formula; those of a predicate are not kept, since many fill the memory."""
    if isinstance(node, f.Comparison) and id(node) not in walk.done:
        return walk.algebra.margin(node)
    return walk(node)


def bounds_at_start(formula: f.Formula, walk: Walk[RhoBounds[Curve]], snap: float) -> Pair:
    """Return the bounds of ρ at the first instant, never 0: their signs are the verdict."""
    return _Extremes(walk, snap).over(formula, None, least=True)


class _Extremes:
    def __init__(self, walk: Walk[RhoBounds[Curve]], snap: float) -> None:
        self.walk, self.snap = walk, snap

    def over(self, node: f.Formula, interval: f.Interval | None, least: bool) -> Pair:
        """Return the bounds of the least, or of the greatest, value over a window; None is the first instant alone."""
        match node:
            case f.Named():
                return self.over(node.operand, interval, least)
            case f.Rescale():
                low, high = self.over(node.operand, interval, least)
                return rescale_number(low, node.factor), rescale_number(high, node.factor)
            case f.Not():
                return _minus(self.over(node.operand, interval, not least))
            case f.Junction() if interval is None or (node.operator == "and") == least:
                fold = min if node.operator == "and" else max
                lows, highs = zip(*(self.over(part, interval, least) for part in node.operands), strict=True)
                return fold(lows), fold(highs)
            case f.Implication(operator="->") if interval is None:
                left, right = _minus(self.over(node.left, None, least)), self.over(node.right, None, least)
                return max(left[0], right[0]), max(left[1], right[1])
            case f.Temporal(operator="always" | "eventually") if interval is None:
                return self.over(node.operand, node.interval, least=node.operator == "always")
            case f.Temporal(operator="always" | "eventually" as operator):
                if interval is not None and (operator == "always") == least:
                    return self.over(node.operand, _sum(interval, node.interval), least)
        curves = curves_of(node, self.walk)
        if interval is None:
            return float(curves.lower.at[0]), float(curves.upper.at[0])
        sign = 1.0 if least else -1.0
        low, high = (
            sign * infimum_over(x if least else -x, interval, self.snap) for x in (curves.lower, curves.upper)
        )
        return low, high


def _sum(outer: f.Interval, inner: f.Interval) -> f.Interval:
    """Return the window that an inner window covers from the instants of an outer one."""
    return replace(
        outer,
        low=outer.low + inner.low,
        high=outer.high + inner.high,
        low_closed=outer.low_closed and inner.low_closed,
        high_closed=outer.high_closed and inner.high_closed,
    )


def _minus(pair: Pair) -> Pair:
    return -pair[1], -pair[0]


def infimum_over(x: Curve, interval: f.Interval, snap: float) -> float:
    """Return the infimum of a curve over an interval after its first instant; +inf if no instant lies in it."""
    start, end, last = x.times[0] + interval.low, x.times[0] + interval.high, x.times[-1]
    if start > last + snap:
        return np.inf
    first = int(np.searchsorted(x.times, start - snap if interval.low_closed else start + snap))
    stop = int(np.searchsorted(x.times, end + snap if interval.high_closed else end - snap))
    low = float(x.at[first:stop].min(initial=np.inf))
    end = min(end, last)
    if not x.right.size or end - start <= snap:
        closed = interval.low_closed and interval.high_closed
        return min(low, float(x.values(np.array([min(start, last)]), snap)[0])) if closed else low
    begin = int(np.clip(np.searchsorted(x.times, start + snap, side="right") - 1, 0, x.right.size - 1))
    final = int(np.clip(np.searchsorted(x.times, end - snap, side="left") - 1, begin, x.right.size - 1))
    pieces = np.array([begin, final])
    ends = x.along(pieces, np.array([start, end]))
    return min(
        low,
        float(ends.min()),
        float(x.right[begin + 1 : final + 1].min(initial=np.inf)),
        float(x.left[begin:final].min(initial=np.inf)),
    )
