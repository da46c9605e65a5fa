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


def in_brackets(name: str) -> str | None:
    """Return the unit of time in brackets at the end of a name, ``time (ns)``; None if there is none."""
    split = split_brackets(name)
    return split[1] if split is not None and size(split[1]) is not None else None


def last_word(name: str) -> str:
    """Return the last word of a name in lower case: "us" for time_us, TimeUS and stamp.us."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name[-100:])
    return words[-1].lower() if words else ""


def unit_in_name(name: str) -> str | None:
    """Return the unit that the name of a column states, or None."""
    word = last_word(name)
    return SUB.get(word, "s" if word in WHOLE else None)


def looks_like(stamp: float) -> str | None:
    """Return the unit in which a large stamp since 1970 is between the years 2000 and 2100; None if there is none."""
    return next(
        (unit for unit in ("ms", "us", "ns") if _YEARS[0] <= abs(stamp) * float(_SIZES[unit]) <= _YEARS[1]),
        None,
    )
