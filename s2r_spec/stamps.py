"""Time stamps to seconds, exactly: whole counts are subtracted before anything is rounded.

A count v of a unit u = p/q seconds (p, q whole) becomes v·p/q. Dates count from the first stamp, (v − v₀)·p/q, as
float64 seconds since 1970 resolve 0.24 µs only. Both are correctly rounded for counts below 2⁵³.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError
from s2r_spec.instants import DATES

FloatArray = NDArray[np.float64]

_UNITS = {
    "W": Fraction(604800), "D": Fraction(86400), "h": Fraction(3600), "m": Fraction(60), "s": Fraction(1),
    "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9), "ps": Fraction(1, 10**12),
    "fs": Fraction(1, 10**15), "as": Fraction(1, 10**18),
}  # fmt: skip
_EPOCH = datetime(1970, 1, 1)


def typed(values: NDArray[Any]) -> NDArray[Any]:
    """Return the array with Python's dates and durations as numpy's, in nanoseconds; any other as it is.

    Raises:
        TraceError: one of them is no date (NaT).
    """
    if values.dtype != object or not values.size:
        return values
    first = values.flat[0]
    if not isinstance(first, datetime | timedelta):
        return values
    try:
        counts = np.array([_nanoseconds(one) for one in values.flat], dtype=np.int64).reshape(values.shape)
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise TraceError(f"one of the dates or durations cannot be used: {error}") from None
    return counts.view("M8[ns]" if isinstance(first, datetime) else "m8[ns]")


def _nanoseconds(one: Any) -> int:
    """Return the nanoseconds of a duration, or since 1970 of a date; without a zone it is UTC."""
    if isinstance(one, datetime):
        below = int(getattr(one, "nanosecond", 0))
        naive = one if one.tzinfo is None else one.astimezone(UTC).replace(tzinfo=None)
        return (
            _nanoseconds(
                naive.to_pydatetime() - _EPOCH if hasattr(naive, "to_pydatetime") else naive - _EPOCH
            )
            + below
        )
    whole = (one.days * 86400 + one.seconds) * 10**6 + one.microseconds
    return int(whole) * 1000 + int(getattr(one, "nanoseconds", 0))


def is_typed(values: NDArray[Any]) -> bool:
    """Return whether the array holds dates or durations, whose type says their unit."""
    return values.dtype.kind in "Mm"


def seconds(values: NDArray[Any], first: Any = None) -> FloatArray:
    """Return the seconds that dates or durations are; dates count from the first one.

    Args:
        values: (n,) of datetime64 or timedelta64.
        first: the date to count from, if it is not the first of these.

    Raises:
        TraceError: one of them is not a time (NaT), or the type has no unit.
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
    return counted(counts, size, from_first=dated, first=start)


EXACT = 2**50
"""Tolerance: counts below this, 13 days of nanoseconds, stay apart as float64 seconds; at 2⁵³ neighbours become one."""


def dates(values: NDArray[Any], size: Fraction) -> bool:
    """Return whether counts of a unit that is not the second count from the first one.

    They do if they are dates, which begin later than in 1973, or too many for float64 seconds.
    """
    if size == 1 or not values.size:
        return False
    first = abs(float(values[0]))
    return first * float(size) >= DATES or first >= EXACT


def counted(
    values: NDArray[Any], size: Fraction, *, from_first: bool = False, first: int | float | None = None
) -> FloatArray:
    """Return the seconds of counts, (n,) whole or not, of a unit of ``size`` [s].

    Args:
        values: the counts.
        size: the unit [s].
        from_first: subtract the first count, exactly where the counts are whole.
        first: what to subtract then, if it is not the first of these.
    """
    if from_first and values.size:
        values = values - values.dtype.type(values[0] if first is None else first)
    number = np.asarray(values, dtype=np.float64)
    if size.numerator != 1:
        number = number * float(size.numerator)
    return number if size.denominator == 1 else number / float(size.denominator)
