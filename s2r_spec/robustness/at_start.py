"""ρ at the first instant of curves, without the curve of ρ at every other one.

Model: min and max are associative, so that an ``always`` over a conjunction is the least of the parts, each over the
same window, and an ``always`` within an ``always`` has the sum of both windows. So most requirements need one extreme
of each predicate, and no curve over all stamps of all signals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.lang import formula as f
from s2r_spec.robustness.bounds import BoundedAlgebra, RhoBounds
from s2r_spec.robustness.curve import Curve
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.ties import rescale_number

FloatArray = NDArray[np.float64]
Pair = tuple[float, float]


def curves_of(node: f.Formula, walk: Walk[RhoBounds[Curve]]) -> RhoBounds[Curve]:
    """Return the curves of a formula; those of a predicate are not kept, since many fill the memory."""
    if isinstance(node, f.Comparison) and id(node) not in walk.done:
        assert isinstance(walk.algebra, BoundedAlgebra)
        return walk.algebra.margin(node)
    return walk(node)


def bounds_at_start(formula: f.Formula, walk: Walk[RhoBounds[Curve]], snap: float) -> Pair:
    """Return the bounds of ρ at the first instant, never 0: their signs are the verdict."""
    return _Start(walk, snap).value(formula)


class _Start:
    def __init__(self, walk: Walk[RhoBounds[Curve]], snap: float) -> None:
        self.walk, self.snap = walk, snap

    def value(self, node: f.Formula) -> Pair:
        """Return the bounds of a formula at the first instant."""
        match node:
            case f.Temporal(operator="always" | "eventually"):
                return self.extreme(node.operand, node.interval, least=node.operator == "always")
            case _:
                return self._combine_parts(node, self.value) or self._first(node)

    def _first(self, node: f.Formula) -> Pair:
        curves = curves_of(node, self.walk)
        return float(curves.lower.at[0]), float(curves.upper.at[0])

    def _combine_parts(self, node: f.Formula, of: Callable[[f.Formula], Pair]) -> Pair | None:
        """Return the bounds of a formula from those of its parts at the same instant; None if it has no such parts."""
        match node:
            case f.Named():
                return of(node.operand)
            case f.Not():
                return _minus(of(node.operand))
            case f.Rescale():
                low, high = of(node.operand)
                return rescale_number(low, node.factor), rescale_number(high, node.factor)
            case f.Junction():
                fold = min if node.operator == "and" else max
                parts = [of(operand) for operand in node.operands]
                return fold(low for low, _ in parts), fold(high for _, high in parts)
            case f.Implication(operator="->"):
                left, right = _minus(of(node.left)), of(node.right)
                return max(left[0], right[0]), max(left[1], right[1])
            case _:
                return None

    def extreme(self, node: f.Formula, interval: f.Interval, least: bool) -> Pair:
        """Return the bounds of the least, or of the greatest, value of a formula over a window."""
        match node:
            case f.Named() | f.Rescale():
                parts = self._combine_parts(node, lambda operand: self.extreme(operand, interval, least))
                assert parts is not None
                return parts
            case f.Not():
                return _minus(self.extreme(node.operand, interval, not least))
            case f.Junction() if (node.operator == "and") == least:
                fold = min if least else max
                each = [self.extreme(operand, interval, least) for operand in node.operands]
                return fold(low for low, _ in each), fold(high for _, high in each)
            case f.Temporal(operator="always" | "eventually") if (node.operator == "always") == least:
                inner = node.interval
                total = replace(
                    interval,
                    low=interval.low + inner.low,
                    high=interval.high + inner.high,
                    low_closed=interval.low_closed and inner.low_closed,
                    high_closed=interval.high_closed and inner.high_closed,
                )
                return self.extreme(node.operand, total, least)
            case _:
                curves = curves_of(node, self.walk)
                sign = 1.0 if least else -1.0
                low, high = (
                    sign * infimum_over(x if least else -x, interval, self.snap)
                    for x in (curves.lower, curves.upper)
                )
                return low, high


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
