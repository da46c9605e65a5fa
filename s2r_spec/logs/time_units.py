"""Units of time stamps, exactly, and the names that say one."""

from __future__ import annotations

import re
from fractions import Fraction

from s2r_spec.lang.units import LONGEST, SECOND, UnknownUnitError, parse_unit

_SIZES = {
    "s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "µs": Fraction(1, 10**6),
    "μs": Fraction(1, 10**6), "ns": Fraction(1, 10**9), "min": Fraction(60), "h": Fraction(3600),
    "sec": Fraction(1), "msec": Fraction(1, 10**3), "usec": Fraction(1, 10**6), "nsec": Fraction(1, 10**9),
}  # fmt: skip
"""Definition: units whose size is exact, and needs no library."""

SUB = {
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisec", "millisecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "usecs", "micros", "microsec", "microsecs", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"),
}  # fmt: skip
"""Definition: last words of a name that say a unit below the second."""
WHOLE = frozenset(("s", "sec", "secs", "second", "seconds"))
"""Definition: last words of a name that say seconds."""

_EPOCH = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Definition: from 1e11 on a stamp is no second since 1970 (the year 5138). In ms it is of 1973, in us 1e14 is."""


def size(text: str) -> Fraction | None:
    """Return how long a unit of time is [s]; None if the text is no unit of time."""
    text = text.strip()
    if text in _SIZES:
        return _SIZES[text]
    try:
        unit = parse_unit(text)
    except UnknownUnitError:
        return None
    if not text or not unit.fits(SECOND) or unit.offset:
        return None
    return Fraction(f"{unit.factor:.15g}")


def bracketed(name: str) -> tuple[str, str] | None:
    """Return what stands before brackets at the end of a name, and in them: ``v (m/s)``, ``v[m/s]``; None if none."""
    for opening, closing in ("()", "[]"):
        if name.endswith(closing) and opening in name[1:]:
            at = name.rindex(opening)
            if 0 < len(name) - at - 2 <= LONGEST:
                return name[:at].rstrip(), name[at + 1 : -1]
    return None


def in_brackets(name: str) -> str | None:
    """Return the unit of time that a name has in brackets at its end, ``time (ns)``; None if none."""
    found = bracketed(name)
    return found[1] if found is not None and size(found[1]) is not None else None


def last_word(name: str) -> str:
    """Return the last word of a name in small letters: "us" of time_us, TimeUS and stamp.us."""
    found = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name[-100:])
    return found[-1].lower() if found else ""


def said(name: str) -> str | None:
    """Return the unit that the name of a column says, or None."""
    word = last_word(name)
    return SUB.get(word, "s" if word in WHOLE else None)


def looks_like(stamp: float) -> str | None:
    """Return the unit that a stamp since 1970 must have, as it cannot be seconds; None if it can."""
    return next((unit for least, unit in _EPOCH if abs(stamp) >= least), None)
