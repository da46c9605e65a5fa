"""Exact units of time stamps, and the names of columns that state one."""

from __future__ import annotations

import re
from fractions import Fraction

from s2r_spec.lang.units import LONGEST, SECOND, UnknownUnitError, parse_unit

_SIZES = {
    "s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "µs": Fraction(1, 10**6),
    "μs": Fraction(1, 10**6), "ns": Fraction(1, 10**9), "min": Fraction(60), "h": Fraction(3600),
    "sec": Fraction(1), "msec": Fraction(1, 10**3), "usec": Fraction(1, 10**6), "nsec": Fraction(1, 10**9),
}  # fmt: skip
"""Definition: units with an exact size [s], which need no library."""

SUB = {
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisec", "millisecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "usecs", "micros", "microsec", "microsecs", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), "min"),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), "h"),
    **dict.fromkeys(("day", "days"), "day"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"),
}  # fmt: skip
"""Definition: last words of a name that state a unit of time other than the second."""
WHOLE = frozenset(("s", "sec", "secs", "second", "seconds"))
"""Definition: last words of a name that state seconds."""

TOO_LARGE = 1e11
"""Definition: smallest stamp that is not in seconds since 1970; it would be in the year 5138 [s]."""
_YEARS = (946_684_800.0, 4_102_444_800.0)
"""Definition: the begin of the years 2000 and 2100 since 1970 [s], between which robots are recorded."""


def size(text: str) -> Fraction | None:
    """Return the size of a unit of time [s]; None if the text is not a unit of time."""
    text = text.strip()
    if text in _SIZES:
        return _SIZES[text]
    try:
        unit = parse_unit(text)
    except UnknownUnitError:
        return None
    if not text or not unit.fits(SECOND) or unit.offset:
        return None
    return unit.factor


def split_brackets(name: str) -> tuple[str, str] | None:
    """Split ``v (m/s)`` or ``v[m/s]`` into the name and the text in brackets; None without brackets at the end."""
    for opening, closing in ("()", "[]"):
        if name.endswith(closing) and opening in name[1:]:
            at = name.rindex(opening)
            if 0 < len(name) - at - 2 <= LONGEST:
                return name[:at].rstrip(), name[at + 1 : -1]
    return None


def words(name: str) -> list[str]:
    """Return the words of a name in lower case: "stamp" and "us" for stamp_us, stampUS and stamp.us."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


def last_word(name: str) -> str:
    """Return the last word of a name in lower case."""
    return next(reversed(words(name[-100:])), "")


def looks_like(stamp: float) -> str | None:
    """Return the unit in which a large stamp since 1970 is between the years 2000 and 2100; None if there is none."""
    return next(
        (unit for unit in ("ms", "us", "ns") if _YEARS[0] <= abs(stamp) * float(_SIZES[unit]) <= _YEARS[1]),
        None,
    )
