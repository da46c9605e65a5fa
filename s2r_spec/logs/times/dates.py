"""Convert dates as text (ISO 8601 and similar) to nanoseconds since 1970."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, shortened
from s2r_spec.logs import cells

_DATE = re.compile(
    r"(\d{4})[-/](\d{2})[-/](\d{2})"
    r"(?:[Tt ](\d{2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9})\d{0,9})?)? ?(Z|z|UTC|[+-]\d{2}(?::?\d{2})?)?)?",
    re.ASCII,
)
LIKE = "2024-06-10T06:13:20.5Z"
LAST = 9e9
"""Definition: largest time since 1970 [s] whose nanoseconds fit 64 bits, in the year 2255."""


def is_date(text: str) -> bool:
    """Return whether a text is a date, as far as its form tells."""
    return _DATE.fullmatch(text) is not None


def nanoseconds(texts: NDArray[Any], place: Callable[[int], str]) -> NDArray[np.datetime64]:
    """Return (n,) dates with or without time, fraction and zone, in nanoseconds, in UTC if they state a zone.

    Raises:
        TraceError: a text is not a date, or only some of the dates state a time zone.
    """
    whole: list[str] = []
    rest = np.zeros(len(texts), dtype=np.int64)
    zoned: bool | None = None
    for sample, text in enumerate(texts):
        match = _DATE.fullmatch(text)
        if match is None:
            raise TraceError(
                f"{place(sample)} is {shortened(text)!r}, neither a number nor a time such as {LIKE} or 10:00:00.5"
                f"{cells.decimal_point(text)}"
            )
        year, month, day, hour, minute, second, fraction, zone = match.groups()
        whole.append(f"{year}-{month}-{day}T{hour or '00'}:{minute or '00'}:{second or '00'}")
        rest[sample] = int((fraction or "0").ljust(9, "0")) - _offset(zone)
        if zoned is None:
            zoned = zone is not None
        if zoned != (zone is not None):
            raise TraceError(
                f"{place(sample)} is {text!r}: only some of the dates state a time zone; state it for all or none"
            )
    dates: NDArray[np.datetime64] = _seconds(whole, texts, place).astype("M8[ns]") + rest.view("m8[ns]")
    return dates


def _offset(zone: str | None) -> int:
    if zone is None or zone in ("Z", "z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    minutes = 60 * int(digits[:2]) + int(digits[2:])
    return (-minutes if zone[0] == "-" else minutes) * 60 * 10**9


def _seconds(whole: list[str], texts: NDArray[Any], place: Callable[[int], str]) -> NDArray[np.datetime64]:
    try:
        seconds = np.array(whole, dtype="M8[s]")
    except ValueError:
        for sample, text in enumerate(whole):
            try:
                np.datetime64(text, "s")
            except ValueError:
                raise TraceError(
                    f"{place(sample)} is {texts[sample]!r}, which is not a date of the calendar"
                ) from None
        raise
    outside = (seconds < np.datetime64("1678", "s")) | (seconds > np.datetime64("2262", "s"))
    if outside.any():
        bad = int(np.argmax(outside))
        raise TraceError(f"{place(bad)} is {texts[bad]!r}; a date must lie between 1678 and 2261")
    return seconds


def text(date: np.datetime64) -> str:
    """Return a date as text, without trailing zeros."""
    written = str(np.datetime_as_string(date))
    return written.rstrip("0").rstrip(".") if "." in written else written
