"""Sample times on a regular grid, and time intervals in numbers of samples."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from s2r_spec.base.arrays import FloatArray, IntArray
from s2r_spec.base.errors import TraceError
from s2r_spec.lang.formula import Interval
from s2r_spec.robustness.kernels import until, window_max, window_min
from s2r_spec.trace.messages import INTERVALS, period_of_messages

Window = Callable[[FloatArray, int, int | None], FloatArray]

JITTER = 1e-2
"""Tolerance: distance of a sample time from the grid, in periods, up to which it is on the grid."""
SNAP = 1e-6
"""Tolerance: distance of an interval's end from a sample, in periods, up to which it is on the sample. So 0.3 s is the
third sample of 0.1 s."""


def sent_on_change(times: FloatArray) -> bool:
    """Return whether samples at (n,) increasing times [s] come irregularly, as values that are sent on change."""
    if times.size < 2 or Grid.of(times) is not None:
        return False
    return times.size <= INTERVALS or math.isnan(period_of_messages(times))


@dataclass(frozen=True)
class Grid:
    """Samples at a regular period.

    Args:
        count: number of samples, ≥ 1.
        period: time between samples [s]; None for a single sample.
        jitter: greatest distance of a sample from the grid, in periods.
    """

    count: int
    period: Fraction | None
    jitter: float = 0.0

    @classmethod
    def of(cls, times: FloatArray) -> Grid | None:
        """Return the grid of (n,) increasing times [s]; None if a sample is more than 1 % of a period off.

        The period is the simplest fraction that the times allow: files write 0.033 for 1/30, and times accumulate
        rounding.
        """
        count = times.size
        if count == 1:
            return cls(1, None)
        mean = float(times[-1] - times[0]) / (count - 1)
        off = times - times[0]
        off -= mean * np.arange(count)
        jitter = max(float(off.max()), -float(off.min())) / mean
        if jitter > JITTER:
            return None
        rounding = 4 * sys.float_info.epsilon * max(abs(float(times[0])), abs(float(times[-1])))
        slack = 2 * (jitter * mean + rounding) / (count - 1)
        return cls(count, _simplest(mean - slack, mean + slack), jitter)

    @property
    def times(self) -> FloatArray:
        """(n,) times after the first sample [s]."""
        return np.arange(self.count, dtype=np.float64) * self.step

    @property
    def snap(self) -> float:
        """Times closer than this are the same [s]."""
        return SNAP * self.step

    @cached_property
    def step(self) -> float:
        """The period [s]; 0 for a single sample."""
        return float(self.period) if self.period is not None else 0.0

    def windows(self, interval: Interval, past: bool) -> tuple[IntArray, IntArray]:
        """Return (first, last), each (n,): the samples in the window of each sample; empty if last < first."""
        low, high = self.window(interval)
        here, rest = np.arange(self.count), self.count
        if past:
            return np.maximum(here - (rest if high is None else high), 0), here - low
        return here + low, np.minimum(here + (rest if high is None else high), self.count - 1)

    def fewest(self, interval: Interval, past: bool) -> int | None:
        """Return the least number of samples in a window that lies within the trace; None if none does.

        Raises:
            TraceError: see :meth:`window`.
        """
        low, high = self.window(interval)
        if high is None or self.period is None or interval.high > self.seconds(self.count - 1) + self.snap:
            return None
        return high - low + 1

    def always(self, x: FloatArray, interval: Interval, past: bool) -> FloatArray:
        """Return (…, n): the least of x in t + interval (t − interval if ``past``)."""
        return self._over(window_min, x, interval, past)

    def eventually(self, x: FloatArray, interval: Interval, past: bool) -> FloatArray:
        """Return (…, n): the greatest of x in t + interval (t − interval if ``past``)."""
        return self._over(window_max, x, interval, past)

    def _over(self, window: Window, x: FloatArray, interval: Interval, past: bool) -> FloatArray:
        low, high = self.window(interval)
        return _backward(window(_backward(x), low, high)) if past else window(x, low, high)

    def until(self, left: FloatArray, right: FloatArray, interval: Interval, past: bool) -> FloatArray:
        """Return (…, n): see :func:`s2r_spec.robustness.kernels.until`; ``past`` makes it since."""
        low, high = self.window(interval)
        if past:
            return _backward(until(_backward(left), _backward(right), low, high))
        return until(left, right, low, high)

    def window(self, interval: Interval) -> tuple[int, int | None]:
        """Return (low, high): the samples t + low … t + high lie in t + interval; high = None means all the rest.

        An open end excludes the sample on it. An end between two samples excludes the sample outside.

        Raises:
            TraceError: no sample lies in the interval.
        """
        if self.period is None:
            # a single sample: the interval contains it, or lies past the end
            return (0, 0) if interval.low == 0 and interval.low_closed else (1, 1)
        nearest, on = self._nearest(interval.low)
        low = nearest + (not interval.low_closed) if on else math.ceil(interval.low / self.step)
        if math.isinf(interval.high):
            return low, None
        nearest, on = self._nearest(interval.high)
        high = nearest - (not interval.high_closed) if on else math.floor(interval.high / self.step)
        if high < low:
            raise TraceError(
                f"no sample lies in `{interval.span.text}` ({interval.span.place}): "
                f"the sample period is {self.step:g} s"
            )
        return low, high

    def between(self, time: float) -> bool:
        """Return whether a time [s] after a sample lies between two others."""
        return math.isfinite(time) and self.period is not None and not self._nearest(time)[1]

    def _nearest(self, time: float) -> tuple[int, bool]:
        """Return the number of periods nearest to ``time`` [s], and whether ``time`` is on that sample."""
        periods = time / self.step
        nearest = round(periods)
        return nearest, abs(periods - nearest) <= SNAP

    def place(self, sample: int) -> str:
        """Return the place of a sample in words."""
        return f"sample {sample}, {self.seconds(sample):.9g} s after the first"

    def seconds(self, periods: int) -> float:
        """Return the time of a number of periods [s]."""
        return float(periods * self.period) if self.period is not None else 0.0


def _backward(x: FloatArray) -> FloatArray:
    return x[..., ::-1]


def _simplest(low: float, high: float) -> Fraction:
    """Return the fraction with the least denominator in [low, high], 0 < low (Stern–Brocot)."""
    return Fraction(*_between(*low.as_integer_ratio(), *high.as_integer_ratio()))


def _between(a: int, b: int, c: int, d: int) -> tuple[int, int]:
    """Return the numerator and the denominator of the simplest fraction from a/b to c/d."""
    whole, rest = divmod(a, b)
    if not rest:
        return whole, 1
    if (whole + 1) * d <= c:
        return whole + 1, 1
    below, above = _between(d, c - whole * d, b, rest)
    return whole * below + above, below
