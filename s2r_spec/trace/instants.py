"""Times of a trace as text, to the resolution of its samples.

In a log with Unix times ``instant(times, 1718000001.512)`` is ``1.512 s after the first sample (1718000001.512 s)``; in
a trace that begins at 0, ``instant(times, 0.2)`` is ``0.2 s``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

DATES = 1e8
"""Definition: a first time stamp of at least this [s] counts from 1970 (it is 3 March 1973), since no machine runs for
three years."""

_SHARE = 1e-3
"""Tolerance: rounding error of a printed time [sampling periods]."""

_FIXED = 12
"""Definition: largest number of printed decimals; a finer time is printed with an exponent."""


def instant(times: ArrayLike, t: float) -> str:
    """Return a time as text, with its unit.

    Args:
        times: (n,) time stamps [s] of the trace, increasing; the first one and those around ``t`` suffice.
        t: the time on the same clock [s], at a sample or between two.

    Returns:
        The number with the fewest decimals within a thousandth of the sampling period, so that neighbouring samples
        differ; never more decimals than float64 resolves.
    """
    stamps = np.asarray(times, dtype=np.float64).ravel()
    if not math.isfinite(t) or not stamps.size:
        return f"{t:g} s"
    first = float(stamps[0])
    close = max(_SHARE * _step(stamps, t), math.ulp(max(abs(t), abs(first))))
    if first < DATES:
        return f"{_shortest(t, close)} s"
    return f"{_shortest(t - first, close)} s after the first sample ({_shortest(t, close)} s)"


def _step(stamps: np.ndarray, t: float) -> float:
    """Return the shortest sampling period next to a time [s]; 0 for a single sample."""
    place = int(np.searchsorted(stamps, t))
    near = np.abs(np.diff(stamps[max(place - 2, 0) : place + 3]))
    near = near[near > 0]
    return float(near.min()) if near.size else 0.0


def _shortest(number: float, close: float) -> str:
    """Return the number with the fewest decimals for a rounding error of at most ``close``."""
    for decimals in range(_FIXED + 1):
        if abs(round(number, decimals) - number) <= close:
            text = f"{number:.{decimals}f}"
            return text.removeprefix("-") if float(text) == 0 else text
    return f"{number:.6g}"
