"""Sample times (n,) of a trace, and values between samples: pure functions of arrays."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from s2r_spec.base.arrays import FloatArray, IntArray
from s2r_spec.base.errors import TraceError
from s2r_spec.trace import stamps
from s2r_spec.trace.instants import DATES, instant

Rule = Literal["hold", "linear"]
"""How a signal has a value between two samples: that of the last sample, or one on the line between both."""

ROUNDING = 1e-6
"""Tolerance: rounding error of a time [sampling periods]."""
SLOW, FAST = 2.0, 1e-5
"""Tolerance: periods from which, and below which, times without a unit may be in another one than seconds [s]."""
MOST_SAMPLES = 2**25
"""Budget: samples of a trace that is resampled, 34 million."""


def seconds_of(value: Any, what: str) -> float:
    """Return a number of seconds, or a ``timedelta`` of Python, numpy or pandas, in seconds.

    Raises:
        TraceError: it is neither; ``what`` is its name.
    """
    number = math.nan
    try:
        raw = stamps.as_nanoseconds(np.asarray(value).reshape(1))
        if raw.dtype.kind == "m":
            number = float(raw[0] / np.timedelta64(1, "ns") / 1e9)
        elif raw.dtype.kind in "iuf":
            number = float(raw[0])
    except (TypeError, ValueError, TraceError):
        pass
    if math.isnan(number):
        raise TraceError(f"{what} is {value!r}; it must be a number of seconds, or a timedelta")
    return number


def finite_seconds(value: Any, what: str) -> float:
    """Return a finite duration in seconds; see :func:`seconds_of`."""
    number = seconds_of(value, what)
    if math.isinf(number):
        raise TraceError(f"{what} is {value!r}; it must be finite")
    return number


def period_of(times: FloatArray) -> float:
    """Return the median time from one sample to the next [s]; 0 for a single sample."""
    return float(np.median(np.diff(times))) if times.size > 1 else 0.0


def inside(times: FloatArray, low: float, high: float) -> slice:
    """Return the samples from ``low`` to ``high`` [s], both included.

    Raises:
        TraceError: ``high`` is before ``low``, or there is no such sample.
    """
    if high < low:
        raise TraceError(f"the end, {high:g} s, is before the start, {low:g} s")
    close = ROUNDING * period_of(times)
    first, stop = np.searchsorted(times, (low - close, high + close), side="left")
    if first == stop:
        ends = f"{instant(times, times[0])} to {instant(times, times[-1])}"
        raise TraceError(f"no sample lies between {low:g} s and {high:g} s; the trace has {ends}")
    return slice(int(first), int(stop))


def regular(times: FloatArray, step: float) -> tuple[FloatArray, IntArray]:
    """Return (m,) times every ``step`` [s] from the first one on, and (m,) the last sample up to each.

    A time that misses a sample by rounding alone is the sample's own.

    Raises:
        TraceError: the step is not positive, is longer than the trace, or gives too many samples.
    """
    duration = float(times[-1] - times[0])
    if step <= 0:
        raise TraceError(f"the period is {step:g} s; it must be positive")
    if step > duration * (1 + ROUNDING):
        raise TraceError(f"the period, {step:g} s, is longer than the trace, {duration:g} s")
    if duration / step > MOST_SAMPLES:
        raise TraceError(
            f"a period of {step:g} s gives {duration / step:.3g} samples; s2r makes at most {MOST_SAMPLES:.3g}"
        )
    grid = times[0] + step * np.arange(int(duration / step * (1 + 1e-12) + ROUNDING) + 1)
    close = ROUNDING * min(step, period_of(times))
    at = np.searchsorted(times, grid + close, side="right") - 1
    return np.where(np.abs(grid - times[at]) <= close, times[at], grid), at


def between(times: FloatArray, own: FloatArray, values: FloatArray) -> FloatArray:
    """Return (m,) or (m, k) values at times (m,), by linear interpolation of (n,) or (n, k) values at ``own`` (n,)."""
    if values.ndim == 1:
        return np.interp(times, own, values)
    return np.stack([np.interp(times, own, column) for column in values.T], axis=1)


def describe_sampling(times: FloatArray) -> str:
    """Return the number of samples, their rate and their span in words."""
    first, last = float(times[0]), float(times[-1])
    if times.size == 1:
        return f"1 sample at {instant(times, first)}"
    period = period_of(times)
    about = "" if np.abs(np.diff(times) - period).max() <= 0.01 * period else "about "
    span = (
        f"{instant(times, first)} to {instant(times, last)}"
        if abs(first) < DATES
        else f"{last - first:.6g} s from {first:.3f} s since 1970"
    )
    return f"{times.size} samples at {about}{1 / period:.4g} Hz, {span}"
