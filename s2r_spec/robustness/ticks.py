"""Irregular sample times: a window has the samples whose times lie in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray, IntArray
from s2r_spec.base.errors import TraceError
from s2r_spec.lang.formula import Interval
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.kernels import range_min, range_until
from s2r_spec.robustness.once import once

SNAP = 1e-6
"""Tolerance: distance of an interval's end from a sample, in shortest steps, up to which it is on the sample."""


@dataclass(frozen=True)
class Reach:
    """A window relative to an instant, in positions; negative in the past.

    Args:
        low: the start of the window.
        high: the end of the window; inf for the rest of the trace.
        low_closed: whether a sample at its start lies in it.
        high_closed: whether a sample at its end lies in it.
        interval: the interval in the specification.
    """

    low: float
    high: float
    low_closed: bool
    high_closed: bool
    interval: Interval

    @classmethod
    def of(cls, interval: Interval, past: bool) -> Reach:
        """Return t + interval; t − interval if ``past``."""
        reach = cls(interval.low, interval.high, interval.low_closed, interval.high_closed, interval)
        return reach.mirrored() if past else reach

    def mirrored(self) -> Reach:
        """Return the same window on the other side of the instant."""
        return Reach(-self.high, -self.low, self.high_closed, self.low_closed, self.interval)

    def before(self, position: float, at: float, snap: float) -> bool:
        """Return whether a position lies before the window of the instant ``at``."""
        start = at + self.low
        return position < start - snap if self.low_closed else position <= start + snap

    def after(self, position: float, at: float, snap: float) -> bool:
        """Return whether a position lies after the window of the instant ``at``."""
        stop = at + self.high
        return position > stop + snap if self.high_closed else position >= stop - snap

    def samples(self, positions: FloatArray, at: FloatArray, snap: float) -> tuple[IntArray, IntArray]:
        """Return (first, last), each (m,): the indices of (n,) positions in the window of each of (m,) instants.

        The window is empty where last < first.
        """
        start, stop = at + self.low, at + self.high
        first = (
            np.searchsorted(positions, start - snap, "left")
            if self.low_closed
            else np.searchsorted(positions, start + snap, "right")
        )
        last = (
            np.searchsorted(positions, stop + snap, "right")
            if self.high_closed
            else np.searchsorted(positions, stop - snap, "left")
        )
        return first, last - 1


@dataclass(frozen=True, eq=False)
class Ticks:
    """Samples at any increasing times.

    Args:
        times: (n,) times after the first sample [s].
        snap: distance of an interval's end from a sample up to which it is on the sample [s].
    """

    times: FloatArray
    snap: float

    @classmethod
    def of(cls, times: FloatArray) -> Ticks:
        """Make a clock of (n,) increasing times [s]."""
        shortest = float(np.diff(times).min()) if times.size > 1 else 0.0
        rounding = 8 * np.finfo(np.float64).eps * float(np.abs(times).max() + times[-1] - times[0])
        # snapping must never reach half way to a neighbour
        return cls(times - times[0], min(SNAP * shortest + rounding, shortest / 4))

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.times.size

    def seconds(self, sample: int) -> float:
        """Return the time of a sample after the first [s]."""
        return float(self.times[sample])

    def place(self, sample: int) -> str:
        """Return the place of a sample in words."""
        return f"sample {sample}, {self.seconds(sample):.9g} s after the first"

    def windows(self, interval: Interval, past: bool) -> tuple[IntArray, IntArray]:
        """Return (first, last), each (n,): the samples in t + interval (t − interval if ``past``).

        A window that is empty because it lies past the end of the trace has last < first.

        Raises:
            TraceError: a window within the trace lies between two samples.
        """
        first, last, within = self._samples(interval, past)
        if (empty := within & (last < first)).any():
            sample = int(np.argmax(empty))
            raise TraceError(
                f"no sample lies in `{interval.span.text}` ({interval.span.place}) relative to sample {sample}, "
                f"{self.seconds(sample):.9g} s after the first; "
                f"interpolation='hold' or 'linear' evaluates between samples"
            )
        return first, last

    def fewest(self, interval: Interval, past: bool) -> int | None:
        """Return the least number of samples in a window that lies within the trace; None if none does."""
        first, last, within = self._samples(interval, past)
        return int((last - first + 1)[within].min()) if within.any() else None

    def _samples(self, interval: Interval, past: bool) -> tuple[IntArray, IntArray, BoolArray]:
        """Return (first, last, whether the window lies within the trace), each (n,)."""
        times, snap, reach = self.times, self.snap, Reach.of(interval, past)
        within = (times + reach.low >= -snap) & (times + reach.high <= times[-1] + snap)
        return *reach.samples(times, times, snap), within

    def always(self, x: FloatArray, interval: Interval, past: bool) -> FloatArray:
        """Return (…, n): the least of x in the window of each sample."""
        return range_min(x, *self.windows(interval, past))

    def eventually(self, x: FloatArray, interval: Interval, past: bool) -> FloatArray:
        """Return (…, n): the greatest of x in the window of each sample."""
        return np.negative(range_min(np.negative(x), *self.windows(interval, past)))

    def until(self, left: FloatArray, right: FloatArray, interval: Interval, past: bool) -> FloatArray:
        """Return (…, n): see :func:`s2r_spec.robustness.kernels.until`; ``past`` makes it since."""
        first, last = self.windows(interval, past)
        if not past:
            return range_until(left, right, first, last)
        n = self.count
        mirrored = range_until(left[..., ::-1], right[..., ::-1], n - 1 - last[::-1], n - 1 - first[::-1])
        return mirrored[..., ::-1]


Clock = Grid | Ticks
"""The sample times of a trace, and windows on them."""


@once
def clock_of(times: FloatArray) -> Clock:
    """Return the grid that (n,) increasing times [s] lie on, or the times as they are.

    The array must not change, since its clock is computed once.
    """
    return Grid.of(times) or Ticks.of(times)
