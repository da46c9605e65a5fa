"""Window infimum, until and edges of :class:`~s2r_spec.robustness.curve.Curve`.

The results are exact. An output is linear between the instants at which an end of its window meets a breakpoint,
except for crossings of at most three lines. The curve is a sequence of elements, breakpoint 0, piece 0, breakpoint
1, …. A window covers a run of them, and a part of a piece at either end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray, IntArray
from s2r_spec.lang.formula import Interval
from s2r_spec.robustness.curve import Curve, insert_crossings, maximum, merge, minimum, nearest
from s2r_spec.robustness.kernels import range_min
from s2r_spec.robustness.kernels import until as until_samples


def infimum(x: Curve, interval: Interval, snap: float) -> Curve:
    """Return y with y(t) = inf of x on t + interval, cut at the end of the curve; +inf on an empty window.

    Times closer than ``snap`` [s] are the same.
    """
    low, high = interval.low, interval.high
    first, last = x.times[0], x.times[-1]
    ends = np.concatenate([x.times - end for end in {low, high} if math.isfinite(end)])
    times = merge(
        x.times[[0, -1]] if x.times.size > 1 else x.times, ends[(ends > first) & (ends < last)], snap
    )
    elements = np.empty(2 * x.times.size - 1)
    elements[::2] = x.at
    elements[1::2] = np.minimum(x.right, x.left)
    at = _at(x, elements, interval, times, snap)
    middle = (times[:-1] + times[1:]) / 2
    if not middle.size:
        return Curve(times, at, at[:0], at[:0])
    pieces = x.right.size
    start, end = x.piece(middle + low), x.piece(middle + high)
    empty, cut = start >= pieces, end >= pieces
    start, end = np.minimum(start, pieces - 1), np.minimum(end, pieces - 1)
    one = ~cut & (start == end)
    inner = range_min(elements, 2 * (start + 1), np.where(cut, 2 * pieces, 2 * end))
    inner = np.minimum(inner, np.where(one, np.inf, x.left[start]))
    inner = np.minimum(inner, np.where(one | cut, np.inf, x.right[end]))
    inner[empty] = np.inf
    constant = Curve(times, at, inner, inner)
    enters = _line(x, end, times, at, high, cut)
    if low == high:
        return _line(x, start, times, at, low, empty).simplify()
    leaves = _line(x, start, times, at, low, empty)
    return minimum(minimum(leaves, enters, snap), constant, snap)


def _line(
    x: Curve, piece: IntArray, times: FloatArray, at: FloatArray, shift: float, absent: BoolArray
) -> Curve:
    """Return x(t + shift) between ``times``, +inf where it is absent; ``at`` on them."""
    if absent.all():  # also where shift is inf
        beyond = np.full(piece.size, np.inf)
        return Curve(times, at, beyond, beyond)
    right, left = x.along(piece, times[:-1] + shift), x.along(piece, times[1:] + shift)
    return Curve(times, at, np.where(absent, np.inf, right), np.where(absent, np.inf, left))


def _at(x: Curve, elements: FloatArray, interval: Interval, times: FloatArray, snap: float) -> FloatArray:
    """Return the infimum at single instants, which depends on whether the window's ends are closed."""
    low, high = _Ends.of(x, times + interval.low, snap), _Ends.of(x, times + interval.high, snap)
    final = elements.size - 1
    first = np.where(low.on, 2 * low.near + (not interval.low_closed), final + 1)
    first = np.where(low.inside, 2 * (low.piece + 1), first)
    last = np.where(high.on, 2 * high.near - (not interval.high_closed), final)
    last = np.where(high.inside, 2 * high.piece, last)
    result = range_min(elements, first, last)
    if not x.right.size:
        return result
    # the part of a piece in which the window begins or ends
    one = low.inside & high.inside & (low.piece == high.piece)
    for inside, values in (
        (low.inside, x.along(low.piece, low.times)),
        (high.inside, x.along(high.piece, high.times)),
        (low.inside & ~one, x.left[low.piece]),
        (high.inside & ~one, x.right[high.piece]),
    ):
        result = np.minimum(result, np.where(inside, values, np.inf))
    return result


@dataclass(frozen=True, eq=False)
class _Ends:
    """Positions of the ends of windows on a curve: on a breakpoint, inside a piece, or past the end."""

    times: FloatArray
    near: IntArray
    on: BoolArray
    inside: BoolArray
    piece: IntArray

    @classmethod
    def of(cls, x: Curve, times: FloatArray, snap: float) -> _Ends:
        near = nearest(x.times, times)
        on = np.abs(x.times[near] - times) <= snap
        inside = ~on & (times < x.times[-1])
        return cls(times, near, on, inside, np.clip(x.piece(times), 0, max(x.right.size - 1, 0)))


def until(left: Curve, right: Curve, interval: Interval, snap: float) -> Curve:
    """Return y with y(t) = sup over t' in t + interval of min(right(t'), inf of left on [t, t')).

    As in :func:`s2r_spec.robustness.kernels.range_until`, a bounded until is the minimum of the untimed until and
    of the supremum of ``right`` in the window.
    """
    low, high = interval.low, interval.high
    reach = high - low
    from_now = Interval(0.0, reach, interval.low_closed, interval.high_closed, interval.span)
    untimed = _until_untimed(left, right, snap, now=interval.low_closed)
    best = -infimum(-right, from_now, snap)
    result = minimum(best, untimed, snap)
    if low == 0:
        return result
    shifted = -infimum(-result, Interval(low, low, True, True, interval.span), snap)
    guard = infimum(left, Interval(0.0, low, True, False, interval.span), snap)
    return minimum(guard, shifted, snap)


def _until_untimed(left: Curve, right: Curve, snap: float, now: bool) -> Curve:
    """Return the until whose witness is any later instant, or ``now``.

    On a piece without a crossing of the curves, until is max(q(t), min(p(t), K)), where K is the until of the rest of
    the trace at the end of the piece. Breakpoint, start and end of a piece are each a clamp, so the kernel for samples
    computes K.
    """
    p, q = insert_crossings(left, right, snap)
    n = p.times.size
    guards, goals = np.empty(3 * n - 2), np.empty(3 * n - 2)
    guards[::3], goals[::3] = p.at, q.at
    guards[1::3], goals[1::3] = p.right, np.minimum(p.right, q.right)
    guards[2::3], goals[2::3] = p.left, q.left
    value = until_samples(guards, goals, 0, None)
    rest = value[2::3]
    at = value[::3] if now else np.append(np.minimum(p.at[:-1], value[1::3]), -np.inf)
    k = Curve(p.times, at, rest, rest)
    p, q = Curve(p.times, at, p.right, p.left), Curve(p.times, at, q.right, q.left)
    if now:
        return maximum(q, minimum(p, k, snap), snap)
    return minimum(p, maximum(q, k, snap), snap)


def edge(now: Curve, before: Curve, earlier: float, snap: float) -> Curve:
    """Return min(now(t), −before just before t); ``earlier`` is the value before the first instant."""
    x, minus = insert_crossings(now, -before, snap)
    at = np.minimum(x.at, np.concatenate(([-earlier], minus.left)))
    return Curve(x.times, at, np.minimum(x.right, minus.right), np.minimum(x.left, minus.left))
