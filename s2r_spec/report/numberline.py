"""Several intervals on one number line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from s2r_spec.certify.bound.rounding import interval_text


@dataclass(frozen=True)
class Bar:
    """An interval on a number line that includes 0; positions in percent of the line's length."""

    label: str
    words: str
    zero: float
    left: float
    width: float


@dataclass(frozen=True)
class Bars:
    """Intervals on one number line."""

    title: str
    intro: str
    rows: tuple[Bar, ...]
    note: str


def bars(intervals: Sequence[tuple[str, float, float]], unit: str) -> tuple[Bar, ...]:
    """Return (label, lower, upper) intervals on one number line."""
    ends = [0.0, *(end for _, *ends_ in intervals for end in ends_)]
    low, high = min(ends), max(ends)
    room = 0.06 * (high - low or 1.0)
    low, high = low - room, high + room

    def place(value: float) -> float:
        return round(100 * (value - low) / (high - low), 3)

    return tuple(
        Bar(
            label=label,
            words=f"{interval_text(lower, upper)} {unit}".rstrip(),
            zero=place(0.0),
            left=place(lower),
            width=max(0.5, round(place(upper) - place(lower), 3)),
        )
        for label, lower, upper in intervals
    )
