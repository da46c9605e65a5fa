"""The sample times of a growing trace, and the samples in a window."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.lang.formula import Interval
from s2r_spec.robustness import grid, ticks
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.online.tape import InstantSource, Reader, Tape
from s2r_spec.robustness.ticks import Reach
from s2r_spec.trace.instants import instant

Component = Callable[[int], float]


class Advancing(Protocol):
    """A sequence of values that becomes known as samples come."""

    def advance(self) -> None:
        """Compute all values that the samples so far determine."""


@dataclass(frozen=True)
class InstantNumber:
    """A value, or its components, as functions of the instant.

    Args:
        parts: instant → value, one function for each component; NaN where it is undefined.
        sources: the sequences that they read at that instant.
    """

    parts: tuple[Component, ...]
    sources: tuple[InstantSource, ...] = ()

    def end(self, clock: OnlineClock) -> int:
        """Return the number of instants with a known value."""
        end = clock.now + 1
        for source in self.sources:
            if source.end < end:
                end = source.end
        return end

    def keep(self, reader: Reader) -> None:
        """See :class:`~s2r_spec.robustness.online.tape.InstantSource`."""
        for source in self.sources:
            source.keep(reader)


class Indices(Tape):
    """The positions of instants on a grid: their indices, which need no memory."""

    def value(self, k: int) -> float:
        """See :class:`Tape`."""
        return float(k)

    def values(self, first: int, stop: int) -> FloatArray:
        """See :class:`Tape`."""
        return np.arange(first, stop, dtype=np.float64)


class OnlineClock:
    """Sample times so far, as positions on the axis on which windows are measured.

    With a period an instant's position is its index, and windows count samples, as on a
    :class:`~s2r_spec.robustness.grid.Grid`. Without one it is the time since the first sample [s], as on
    :class:`~s2r_spec.robustness.ticks.Ticks`.

    Args:
        period: sample period [s], or None.

    Raises:
        UsageError: the period is not positive.
    """

    def __init__(self, period: float | None) -> None:
        if period is not None and not (period > 0 and math.isfinite(period)):
            raise UsageError(f"period={period} is not a positive number of seconds")
        # 0.1 means 1/10, as in the times of a recorded trace
        self.period = None if period is None else Fraction(period).limit_denominator(10**9)
        self.step = 0.0 if self.period is None else float(self.period)
        # each of two samples may be off by the jitter of a recorded trace
        self.jitter = 2 * grid.JITTER * self.step
        self.positions = Tape() if self.period is None else Indices()
        self.position = self.positions.value  # of an instant
        step = self.step
        self.seconds = self.position if self.period is None else lambda k: k * step  # after the first instant
        self.now = -1  # the last instant seen
        self.latest = 0.0  # its position
        self.round = 0  # number of changes so far
        self.ended = False
        self.start, self.time = 0.0, math.nan  # the first and the last time [s]
        self.shortest = math.inf  # step, without a period [s]
        self.snap = 0.5 if self.period else 0.0
        self.streams: list[Advancing] = []

    def tick(self, time: float) -> None:
        """Add the time of the next sample [s].

        Raises:
            TraceError: it is not finite, not after the last one, or not a period after it.
        """
        if abs(time - self.time - self.step) <= self.jitter and self.period is not None:
            self.time = time
            self.now += 1
        else:
            self._check(time)
        self.round += 1
        if self.period is None:
            self.latest = time - self.start
            rounding = 8 * sys.float_info.epsilon * (abs(time) + self.latest)
            shortest = self.shortest if self.now else 0.0
            self.snap = min(ticks.SNAP * shortest + rounding, shortest / 4)
            self.positions.append(self.latest)
        else:
            self.latest = self.now

    def _check(self, time: float) -> None:
        if not math.isfinite(time):
            raise TraceError(
                f"time stamp {self.now + 1} is {time}; every time must be a finite number of seconds"
            )
        if self.now < 0:
            self.start = time
        else:
            self._check_step(time)
        self.time = time
        self.now += 1

    def check_all(self, times: FloatArray) -> None:
        """Check the times of the next samples [s], without adding them; for errors see :meth:`tick`."""
        steps = np.diff(times, prepend=self.time if self.now >= 0 else times[:1] - (self.step or 1.0))
        near = np.abs(steps - self.step) <= self.jitter if self.period else steps > 0.0
        if np.isfinite(times).all() and near.all():
            return
        probe = copy(self)
        for time in times.tolist():
            probe._check(time)

    def skip(self, times: FloatArray) -> None:
        """Add the checked times of samples [s] that are evaluated as a block, in no window of this clock."""
        if times.size:
            self.start = float(times[0]) if self.now < 0 else self.start
            self.time, self.now = float(times[-1]), self.now + times.size

    def finish(self) -> None:
        """End the trace: no further sample comes."""
        self.ended = True
        self.round += 1

    def _check_step(self, time: float) -> None:
        step = time - self.time
        if step <= 0:
            raise TraceError(
                f"times must increase strictly, but sample {self.now + 1} is at {self._when(time)} "
                f"after {self._when(self.time)}"
            )
        if self.period is not None and abs(step - self.step) > self.jitter:
            raise TraceError(
                f"sample {self.now + 1} at {self._when(time)} comes {step:g} s after the one before, but the period is "
                f"{self.step:g} s; without a period, windows are measured in time"
            )
        self.shortest = min(self.shortest, step)

    def _when(self, time: float) -> str:
        """Return an instant of the trace in words."""
        return instant([self.start, self.time, time], time)

    @property
    def slack(self) -> float:
        """Times closer than this are the same [s]."""
        return self.snap if self.period is None else grid.SNAP * self.step

    def reach(self, interval: Interval, past: bool) -> Reach:
        """Return the window of an interval.

        Raises:
            TraceError: see :meth:`s2r_spec.robustness.grid.Grid.window`.
        """
        if self.period is None:
            return Reach.of(interval, past)
        first, last = Grid(2, self.period).window(interval)
        counted = Reach(float(first), math.inf if last is None else float(last), True, True, interval)
        return counted.mirrored() if past else counted

    def closed(self, reach: Reach, at: float) -> bool:
        """Return whether no later sample can lie in the window of the instant at this position."""
        return self.ended or self.latest >= at + reach.high - self.snap

    def check_empty(self, reach: Reach, k: int, at: float) -> None:
        """Check that the empty window of an instant reaches past an end of the trace.

        Raises:
            TraceError: it lies within the trace, between two samples.
        """
        if at + reach.low < -self.snap or at + reach.high > self.latest + self.snap:
            return
        span = reach.interval.span
        raise TraceError(
            f"no sample lies in `{span.text}` ({span.place}) relative to sample {k}, "
            f"{self.seconds(k):.9g} s after the first"
        )
