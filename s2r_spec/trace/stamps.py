"""Convert time stamps to seconds, exactly: whole counts are subtracted before anything is rounded.

A count v of a unit u = p/q seconds (p, q whole) becomes v·p/q. Dates count from the first stamp, (v − v₀)·p/q, because
float64 seconds since 1970 resolve only 0.24 µs. Both are correctly rounded for counts below 2⁵³.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.trace.instants import DATES

_UNITS = {
    "W": Fraction(604800), "D": Fraction(86400), "h": Fraction(3600), "m": Fraction(60), "s": Fraction(1),
    "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9), "ps": Fraction(1, 10**12),
    "fs": Fraction(1, 10**15), "as": Fraction(1, 10**18),
}  # fmt: skip
_EPOCH = datetime(1970, 1, 1)


def as_nanoseconds(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array of Python's dates or durations as numpy's, in nanoseconds; any other array unchanged.

    Raises:
        TraceError: an element is not a date (NaT).
    """
    if values.dtype != object or not values.size:
        return values
    first = values.flat[0]
    if not isinstance(first, datetime | timedelta):
        return values
    try:
        counts = np.array([_nanoseconds(one) for one in values.flat], dtype=np.int64).reshape(values.shape)
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise TraceError(f"a date or duration is not valid: {error}") from None
    return counts.view("M8[ns]" if isinstance(first, datetime) else "m8[ns]")


def _nanoseconds(one: Any) -> int:
    """Return a duration, or the time of a date since 1970, in nanoseconds; a date without a zone is in UTC."""
    if isinstance(one, datetime):
        below = int(getattr(one, "nanosecond", 0))
        naive = one if one.tzinfo is None else one.astimezone(UTC).replace(tzinfo=None)
        naive = naive.to_pydatetime() if hasattr(naive, "to_pydatetime") else naive
        return _nanoseconds(naive - _EPOCH) + below
    whole = (one.days * 86400 + one.seconds) * 10**6 + one.microseconds
    return int(whole) * 1000 + int(getattr(one, "nanoseconds", 0))


def is_typed(values: NDArray[Any]) -> bool:
    """Return whether an array holds dates or durations, whose type states their unit."""
    return values.dtype.kind in "Mm"


def seconds(values: NDArray[Any], first: Any = None) -> FloatArray:
    """Return dates or durations in seconds; dates count from the first one.

    Args:
        values: (n,) of datetime64 or timedelta64.
        first: the date to count from; None for the first value.

    Raises:
        TraceError: a value is missing (NaT), or the type has no unit.
    """
    if np.isnat(values).any():
        raise TraceError(f"time stamp {int(np.argmax(np.isnat(values)))} is missing (NaT)")
    unit, _ = np.datetime_data(values.dtype)
    if unit in ("Y", "M"):
        values, unit = values.astype(f"{values.dtype.kind}8[D]"), "D"
    if unit not in _UNITS:
        raise TraceError("the dates or durations have no unit; give them one, such as datetime64[ns]")
    size = _UNITS[unit] * np.datetime_data(values.dtype)[1]
    counts = np.ascontiguousarray(values).view(np.int64)
    start = None if first is None else int(np.asarray(first).astype(values.dtype).view(np.int64))
    dated = values.dtype.kind == "M" or dates(counts, size)
    return to_seconds(counts, size, from_first=dated, first=start)


EXACT = 2**50
"""Tolerance: counts below this, 13 days of nanoseconds, differ as float64 seconds; at 2⁵³ two neighbours are equal."""


def dates(values: NDArray[Any], size: Fraction) -> bool:
    """Return whether counts in a unit other than the second must count from the first one.

    They must if they are dates after 1973, or too large for float64 seconds.
    """
    if size == 1 or not values.size:
        return False
    first = abs(float(values[0]))
    return first * float(size) >= DATES or first >= EXACT


def to_seconds(
    values: NDArray[Any], size: Fraction, *, from_first: bool = False, first: int | float | None = None
) -> FloatArray:
    """Return (n,) counts, whole or not, in seconds; ``size`` is their unit [s].

    With ``from_first`` a count is subtracted, exactly if the counts are whole: ``first``, or else the first value.
    """
    if from_first and values.size:
        values = values - values.dtype.type(values[0] if first is None else first)
    number = np.asarray(values, dtype=np.float64)
    if size.numerator != 1:
        number = number * float(size.numerator)
    return number if size.denominator == 1 else number / float(size.denominator)
