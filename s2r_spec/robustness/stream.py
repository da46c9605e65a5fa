"""A signal with messages of its own, as a requirement reads it.

Data: messages (t_i, y_i), (m,) and (width, m), in the declared unit; see :mod:`s2r_spec.trace.messages`. From a start
to an end it gives the spans without a valid value, and a course: one value for each stamp
(:class:`Course`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.trace.messages import Messages, Span

_SLACK = 1e-3
"""Tolerance: by which a rounded angle may exceed the ends of its range [turns]."""


@dataclass(frozen=True, eq=False)
class Course:
    """The messages of a signal, in its declared unit.

    Args:
        times: (m,) strictly increasing stamps after the start [s].
        values: (width, m), free of NaN.
        linear: whether the signal is linear between messages; else it holds the last value.
        ends: (width, m) limits of a linear signal just before each stamp, where it jumps there; None if it does not.
    """

    times: FloatArray
    values: FloatArray
    linear: bool = False
    ends: FloatArray | None = None

    def at(self, times: FloatArray) -> FloatArray:
        """Return (width, n): the values at times, none of them before the first message."""
        if not self.linear:
            index = np.maximum(np.searchsorted(self.times, times, side="right") - 1, 0)
            return self.values[:, index]
        return self._lines(times, "right")

    def before(self, times: FloatArray) -> FloatArray:
        """Return (width, n): the limits of a linear signal just before times."""
        return self._lines(times, "left")

    def _lines(self, times: FloatArray, side: Literal["left", "right"]) -> FloatArray:
        if self.ends is None:
            return np.stack([np.interp(times, self.times, row) for row in self.values])
        last = len(self.times) - 1
        index = np.clip(np.searchsorted(self.times, times, side=side) - 1, 0, last)
        after = np.minimum(index + 1, last)
        width = self.times[after] - self.times[index]
        part = np.divide(times - self.times[index], width, out=np.zeros(times.size), where=width > 0)
        lines: FloatArray = (1.0 - part) * self.values[:, index] + part * self.ends[:, after]
        return lines


@dataclass(frozen=True, eq=False)
class SignalMessages:
    """A signal as a requirement reads it.

    Args:
        messages: its messages, in the log's unit; those without a value are left out.
        values: (width, m) their values in the declared unit.
        without: messages without a value, whose place the value before takes.
        turn: a full turn of an angle, in the declared unit; inf for any other quantity.
    """

    messages: Messages
    values: FloatArray
    without: int = 0
    turn: float = math.inf

    def silences(self, start: float, end: float) -> list[Span]:
        """Return the spans from ``start`` to ``end`` without a valid value, after the start [s]."""
        return [(before - start, after - start) for before, after in self.messages.silences(start, end)]

    def course(self, start: float, end: float, number: int) -> Course:
        """Return the messages with one value for each stamp: the one of a number, or else the last of its stamp."""
        times = self.messages.times
        first = max(int(np.searchsorted(times, start, side="right")) - 1, 0)
        first = int(np.searchsorted(times, times[first], side="left"))
        stop = int(np.searchsorted(times, end, side="right")) + self.messages.linear
        own = times[first:stop]
        last = np.append(own[1:] > own[:-1], True)
        if last.all():
            return self._course(own - start, self.values[:, first:stop])
        ends = np.flatnonzero(last)
        begins = np.concatenate(([0], ends[:-1] + 1))
        chosen = first + np.minimum(begins + number, ends)
        return self._course(own[last] - start, self.values[:, chosen])

    def _course(self, times: FloatArray, values: FloatArray) -> Course:
        """Return the messages as a course; an angle that jumps by over half a turn is linear on the circle."""
        return on_circle(times, values, self.turn) if self.messages.linear else Course(times, values)

    @property
    def topic(self) -> int:
        """A number that signals of one topic share."""
        return id(self.messages.times)

    @property
    def most(self) -> int:
        """The most messages with one stamp."""
        times = self.messages.times
        if times.size < 2 or (np.diff(times) > 0).all():
            return 1
        return int(np.unique(times, return_counts=True)[1].max())


def in_one_turn(values: FloatArray, turn: float) -> bool:
    """Return whether all (width, m) values of each angle lie in one turn, from 0 on or around 0, to within rounding."""
    low, high, slack = values.min(axis=1), values.max(axis=1), _SLACK * turn
    positive = (low >= -slack) & (high <= turn + slack)
    around = (low >= -turn / 2 - slack) & (high <= turn / 2 + slack)
    return bool((positive | around).all())


def on_circle(times: FloatArray, values: FloatArray, turn: float) -> Course:
    """Return an angle that is linear between (width, m) values along the shorter way around the circle.

    Where it passes the end of its range, 0 to a turn or half a turn around 0, it jumps to the other end. An angle of
    several turns, as of a wheel, has no such end: it is linear between its values.
    """
    jumps = np.abs(np.diff(values)) > turn / 2
    if not jumps.any() or not in_one_turn(values, turn):
        return Course(times, values, True)
    high = np.where(values.min(axis=1) >= 0.0, turn, turn / 2)[:, np.newaxis]
    step = np.diff(values)
    short = step - turn * np.rint(step / turn)
    border = np.where(short > 0, high, high - turn)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.clip((border - values[:, :-1]) / short, 0.0, 1.0)
    at = times[:-1] + part * np.diff(times)
    stamps = np.unique(np.concatenate((times, at[jumps])))
    rows, ends = [], []
    for row in range(len(values)):
        mine = jumps[row]
        own = np.concatenate((times, at[row, mine]))
        after = np.concatenate((values[row], border[row, mine] - turn * np.sign(short[row, mine])))
        before = np.concatenate((values[row], border[row, mine]))
        order = np.argsort(own, kind="stable")
        single = Course(own[order], after[np.newaxis, order], True, before[np.newaxis, order])
        rows.append(single.at(stamps)[0])
        ends.append(single.before(stamps)[0])
    return Course(stamps, np.stack(rows), True, np.stack(ends))
