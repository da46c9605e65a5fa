"""Piecewise linear curves in continuous time, with jumps at breakpoints.

A signal that holds its last sample is such a curve, and so is one that is linear between samples. The minimum, the
shift and the window infimum of curves are curves again. Jumps and open interval ends are exact, because a
breakpoint has its own value in addition to the limits on its left and right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from s2r_spec.base.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Curve:
    """A piecewise linear function on [times[0], times[-1]].

    Args:
        times: (m + 1,) breakpoints [s], strictly increasing.
        at: (m + 1,) values at the breakpoints.
        right: (m,) limits just after ``times[:-1]``.
        left: (m,) limits just before ``times[1:]``. Both limits of a piece are finite or equal.
    """

    times: FloatArray
    at: FloatArray
    right: FloatArray
    left: FloatArray

    @classmethod
    def of(cls, times: FloatArray, samples: FloatArray, between: Literal["hold", "linear"]) -> Curve:
        """Return the curve through (n,) samples: each held until the next one, or joined by straight lines."""
        return cls(times, samples, samples[:-1], samples[:-1] if between == "hold" else samples[1:])

    @classmethod
    def constant(cls, times: FloatArray, value: float) -> Curve:
        """Return one value from the first time to the last."""
        ends = times[[0, -1]] if times.size > 1 else times
        return cls.of(ends, np.full(ends.size, value), "hold")

    def __neg__(self) -> Curve:
        return Curve(self.times, -self.at, -self.right, -self.left)

    def backward(self) -> Curve:
        """Return the curve with reversed time."""
        return Curve(-self.times[::-1], self.at[::-1], self.left[::-1], self.right[::-1])

    def map(self, line: Callable[[FloatArray], FloatArray]) -> Curve:
        """Return a linear function of the curve."""
        return Curve(self.times, *map(line, (self.at, self.right, self.left)))

    def piece(self, times: FloatArray) -> IntArray:
        """Return the index of the piece that contains each time, its start included; −1 before the first."""
        return np.searchsorted(self.times, times, "right") - 1

    def along(self, piece: IntArray, times: FloatArray) -> FloatArray:
        """Return the values at ``times`` on the straight line of each piece."""
        start, end = self.times[piece], self.times[piece + 1]
        part = np.clip((times - start) / (end - start), 0.0, 1.0)
        right, left = self.right[piece], self.left[piece]
        with np.errstate(invalid="ignore"):
            value = (1 - part) * right + part * left
        return np.where(right == left, right, value)  # also of infinities

    def refine(self, times: FloatArray) -> Curve:
        """Return the same curve with breakpoints at ``times``, which include its own."""
        if times.size == self.times.size:
            return self
        starts = self.piece(times[:-1])
        at = np.empty(times.size)
        at[:-1] = self.along(starts, times[:-1])
        at[np.searchsorted(times, self.times)] = self.at
        return Curve(times, at, self.along(starts, times[:-1]), self.along(starts, times[1:]))

    def with_breakpoints(self, more: FloatArray, snap: float) -> Curve:
        """Return a copy of the same curve with a few more breakpoints, none within ``snap`` [s] of another one."""
        fresh = _fresh(self.times, more, snap)
        place = np.searchsorted(self.times, fresh)
        values = self.along(place - 1, fresh)
        return Curve(
            np.insert(self.times, place, fresh),
            np.insert(self.at, place, values),
            np.insert(self.right, place, values),
            np.insert(self.left, place - 1, values),
        )

    def values(self, times: FloatArray, snap: float) -> FloatArray:
        """Return the values at ``times``; a time within ``snap`` [s] of a breakpoint counts as the breakpoint."""
        near = nearest(self.times, times)
        on = np.abs(self.times[near] - times) <= snap
        if on.all():
            return self.at[near]
        piece = np.clip(self.piece(times), 0, self.right.size - 1)
        return np.where(on, self.at[near], self.along(piece, times))

    def simplify(self) -> Curve:
        """Return the same curve without the breakpoints inside constant parts."""
        flat = (self.at[1:-1] == self.left[:-1]) & (self.at[1:-1] == self.right[1:])
        flat &= (self.right[:-1] == self.left[:-1]) & (self.right[1:] == self.left[1:])
        if not flat.any():
            return self
        kept = np.concatenate(([True], ~flat, [True]))
        return Curve(self.times[kept], self.at[kept], self.right[kept[:-1]], self.left[kept[1:]])


def nearest(times: FloatArray, targets: FloatArray) -> IntArray:
    """Return the index of the time closest to each target."""
    after = np.clip(np.searchsorted(times, targets), 1, max(times.size - 1, 1))
    if times.size == 1:
        return np.zeros(targets.shape, np.intp)
    return after - (targets - times[after - 1] <= times[after] - targets)


def merge(times: FloatArray, more: FloatArray, snap: float) -> FloatArray:
    """Return all times in order; a time in ``more`` within ``snap`` of another one is left out."""
    return np.sort(np.concatenate((times, _fresh(times, more, snap))))


def _fresh(times: FloatArray, more: FloatArray, snap: float) -> FloatArray:
    """Return the times in ``more`` in order, without those within ``snap`` of another one."""
    fresh = np.sort(more)
    fresh = fresh[np.diff(fresh, prepend=-np.inf) > snap]
    return fresh[np.abs(times[nearest(times, fresh)] - fresh) > snap]


def align(x: Curve, y: Curve, snap: float) -> tuple[Curve, Curve]:
    """Return both curves on common breakpoints; a breakpoint of ``y`` within ``snap`` of one of x moves there."""
    near = nearest(x.times, y.times)
    close = np.abs(x.times[near] - y.times) <= snap
    y = _move(y, np.where(close, x.times[near], y.times))
    times = np.union1d(x.times, y.times)
    return x.refine(times), y.refine(times)


def _move(x: Curve, times: FloatArray) -> Curve:
    """Return the curve with its breakpoints moved to ``times``; pieces of no length are dropped."""
    long = np.diff(times) > 0
    kept = np.append(True, long)
    return Curve(times[kept], x.at[kept], x.right[long], x.left[long])


def insert_crossings(x: Curve, y: Curve, snap: float) -> tuple[Curve, Curve]:
    """Return aligned curves that do not cross within a piece."""
    x, y = align(x, y, snap)
    with np.errstate(invalid="ignore"):
        before, after = x.right - y.right, x.left - y.left
        crossing = np.flatnonzero((before * after < 0) & np.isfinite(before) & np.isfinite(after))
    if not crossing.size:
        return x, y
    start, end = x.times[crossing], x.times[crossing + 1]
    inner = start + (end - start) * before[crossing] / (before[crossing] - after[crossing])
    inner = inner[(inner > start + snap) & (inner < end - snap)]
    times = np.sort(np.concatenate((x.times, inner)))
    return x.refine(times), y.refine(times)


def minimum(x: Curve, y: Curve, snap: float) -> Curve:
    """Return the smaller of two curves at each instant."""
    x, y = insert_crossings(x, y, snap)
    return Curve(
        x.times, np.minimum(x.at, y.at), np.minimum(x.right, y.right), np.minimum(x.left, y.left)
    ).simplify()


def maximum(x: Curve, y: Curve, snap: float) -> Curve:
    """Return the greater of two curves at each instant."""
    return -minimum(-x, -y, snap)


def add(x: Curve, y: Curve, snap: float) -> Curve:
    """Return the sum of two curves."""
    x, y = align(x, y, snap)
    with np.errstate(invalid="ignore", over="ignore"):
        return Curve(x.times, x.at + y.at, x.right + y.right, x.left + y.left)


def split_at_zero(x: Curve, snap: float) -> Curve:
    """Return the same curve with a breakpoint at each crossing of 0, where its value is exactly 0."""
    with np.errstate(invalid="ignore"):
        opposite = (x.right < 0) != (x.left < 0)
        crossing = np.flatnonzero(opposite & np.isfinite(x.right * x.left) & (x.right * x.left != 0))
    if not crossing.size:
        return x
    start, end = x.times[crossing], x.times[crossing + 1]
    inner = start + (end - start) * x.right[crossing] / (x.right[crossing] - x.left[crossing])
    inner = inner[(inner > start + snap) & (inner < end - snap)]
    fine = x.refine(np.sort(np.concatenate((x.times, inner))))
    new = ~np.isin(fine.times, x.times)
    return Curve(
        fine.times,
        np.where(new, 0.0, fine.at),
        np.where(new[:-1], 0.0, fine.right),
        np.where(new[1:], 0.0, fine.left),
    )


def sign(x: Curve, snap: float) -> Curve:
    """Return −1, 0 or 1."""
    fine = split_at_zero(x, snap)
    between = np.sign(fine.right + fine.left)
    return Curve(fine.times, np.sign(fine.at), between, between)
