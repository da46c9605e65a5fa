"""Instants as people look them up: to the resolution of the samples, after the first one where stamps are dates.

``instant(times, 1718000001.512)`` is ``1.512 s after the first sample (1718000001.512 s)`` of a log with Unix times,
and ``0.2 s`` of a trace that begins at 0.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

DATES = 1e8
"""Definition: first stamps [s] from here on (3 March 1973) count from 1970; no machine has run for three years.

Twice as much is 1976: no log of a robot lies between.
"""

_SHARE = 1e-3
"""Tolerance: an instant is printed this close [periods]; twice as much saves a digit now and then."""

_FIXED = 12
"""Definition: the most decimals that are written out; a finer instant has an exponent."""


def instant(times: ArrayLike, t: float) -> str:
    """Return an instant in words, with its unit.

    Args:
        times: (n,) stamps [s] of the trace, increasing; the first one and those around ``t`` are enough.
        t: the instant on the same clock [s], at a sample or not.

    Returns:
        As few decimals as bring the number within a thousandth of the period around it, so that
        neighbouring samples differ; never more than float64 resolves.
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
    """Return the shortest distance of neighbours next to an instant [s]; 0 of a single sample."""
    place = int(np.searchsorted(stamps, t))
    near = np.abs(np.diff(stamps[max(place - 2, 0) : place + 3]))
    near = near[near > 0]
    return float(near.min()) if near.size else 0.0


def _shortest(number: float, close: float) -> str:
    """Return the number with the fewest decimals that are not farther off than ``close``."""
    for decimals in range(_FIXED + 1):
        if abs(round(number, decimals) - number) <= close:
            text = f"{number:.{decimals}f}"
            return text.removeprefix("-") if float(text) == 0 else text
    return f"{number:.6g}"
