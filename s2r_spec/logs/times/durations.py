"""Convert durations and times of day as text to nanoseconds.

Durations are those of pandas, ``-1 days +23:59:59.9``, of Python, ``1 day, 2:03:04``, and of ISO 8601, ``PT0.1S``. A
clock alone, ``10:00:00.1``, is a time of day, or the time since a start: s2r counts both from the first sample.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError

_FRACTION = r"(?:[.,](\d{1,9})\d{0,9})?"
_CLOCK = rf"(\d{{1,6}}):([0-5]\d):([0-5]\d){_FRACTION}"
_OF_DAY = re.compile(_CLOCK, re.ASCII)
_DAYS = re.compile(rf"([+-]?\d{{1,5}}) days?(?:,? ([+-]?){_CLOCK})?", re.ASCII)
_ISO = re.compile(
    rf"([+-]?)P(?=\d|T)(?:(\d{{1,5}})D)?(?:T(?=\d)(?:(\d{{1,6}})H)?(?:(\d{{1,8}})M)?(?:(\d{{1,9}}){_FRACTION}S)?)?",
    re.ASCII,
)


@dataclass(frozen=True)
class ClockTime:
    """A time of a clock without a date, in nanoseconds since its midnight or its start."""

    count: int

    def __str__(self) -> str:
        seconds, below = divmod(self.count, 10**9)
        text = f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}.{below:09}"
        return text.rstrip("0").rstrip(".")


def is_one(text: str) -> bool:
    """Return whether a text is a duration or a time of day."""
    return _parse(text) is not None


def of_clock(text: str) -> bool:
    """Return whether a text is a time of day, or hours, minutes and seconds without days."""
    return _OF_DAY.fullmatch(text) is not None


def nanoseconds(texts: NDArray[Any], place: Callable[[int], str]) -> NDArray[np.timedelta64]:
    """Return (n,) durations, or times of day, in nanoseconds.

    Raises:
        TraceError: a text is not a duration, or only some of the texts state days.
    """
    counts = np.zeros(len(texts), dtype=np.int64)
    for sample, text in enumerate(texts):
        count = _parse(text)
        if count is None or of_clock(text) != of_clock(texts[0]):
            raise TraceError(
                f"{place(sample)} is {text!r}, and the first time is {texts[0]!r}; write all times in one form"
            )
        counts[sample] = count
    return counts.view("m8[ns]")


def _parse(text: str) -> int | None:
    if match := _OF_DAY.fullmatch(text):
        return _count(*match.groups())
    if match := _DAYS.fullmatch(text):
        days, sign, *clock = match.groups()
        rest = _count(*clock)
        return 86400 * 10**9 * int(days) + (-rest if sign == "-" else rest)
    if match := _ISO.fullmatch(text):
        sign, days, *clock = match.groups()
        count = 86400 * 10**9 * int(days or 0) + _count(*clock)
        return -count if sign == "-" else count
    return None


def _count(hours: str | None, minutes: str | None, seconds: str | None, fraction: str | None) -> int:
    whole = 3600 * int(hours or 0) + 60 * int(minutes or 0) + int(seconds or 0)
    return whole * 10**9 + int((fraction or "0").ljust(9, "0"))
