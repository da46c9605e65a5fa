"""Functions of a signal's past: delay, derivative, integral, mean, duration, count.

Arrays are (…, n), time last; ``times`` are (n,) [s], strictly increasing. Differences of times below ``snap`` [s] are
rounding. No function uses later samples, so each can run online.
"""

from __future__ import annotations

import math

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray


def delay(x: FloatArray, times: FloatArray, seconds: float, snap: float) -> FloatArray:
    """Return (…, n): x at the last sample at or before t − seconds, or else the first one."""
    index = np.searchsorted(times, times - seconds + snap, "right") - 1
    return x[..., np.maximum(index, 0)]


def derivative(x: FloatArray, times: FloatArray) -> FloatArray:
    """Return (…, n): the backward difference quotient [1/s]; the first sample has the value of the second."""
    if times.size == 1:
        return np.zeros_like(x)
    slopes = np.diff(x, axis=-1) / np.diff(times)
    return np.concatenate((slopes[..., :1], slopes), axis=-1)


def integral(x: FloatArray, times: FloatArray, seconds: float) -> FloatArray:
    """Return (…, n): the integral of straight lines over [t − seconds, t], from the first sample on."""
    steps = np.diff(times) * (x[..., 1:] + x[..., :-1]) / 2
    total = np.concatenate((np.zeros_like(x[..., :1]), np.cumsum(steps, axis=-1)), axis=-1)
    if math.isinf(seconds) or times.size == 1:
        return total
    start = np.maximum(times - seconds, times[0])
    before = np.minimum(np.searchsorted(times, start, "right") - 1, times.size - 2)
    part = start - times[before]
    slope: FloatArray = np.diff(x, axis=-1) / np.diff(times)
    since: FloatArray = total - total[..., before] - part * (x[..., before] + slope[..., before] * part / 2)
    return since


def mean(x: FloatArray, times: FloatArray, seconds: float) -> FloatArray:
    """Return (…, n): the integral divided by its length; the sample itself at length 0."""
    elapsed = np.minimum(times - times[0], seconds)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(elapsed > 0, integral(x, times, seconds) / elapsed, x)


def duration(holds: BoolArray, times: FloatArray) -> FloatArray:
    """Return (…, n): the time for which the condition has held without a break [s]."""
    begins = holds & ~np.concatenate((np.zeros_like(holds[..., :1]), holds[..., :-1]), axis=-1)
    since = np.maximum.accumulate(np.where(begins, times, -np.inf), axis=-1)
    return np.where(holds, times - since, 0.0)


def count(holds: BoolArray, times: FloatArray, seconds: float, snap: float) -> FloatArray:
    """Return (…, n): the number of samples in [t − seconds, t] at which the condition held."""
    total = np.cumsum(holds, axis=-1, dtype=np.float64)
    first = np.searchsorted(times, times - seconds - snap, "left")
    before = np.concatenate((np.zeros_like(total[..., :1]), total), axis=-1)[..., first]
    return total - before
