"""Places in words: a window of time, a part of the machine, and values of channels or parameters.

Every sentence on a place uses :class:`Place`. It names the time first, because a reader finds a place in a recording by
its time. Numbers are rounded to the width of their range, so that a reader needs no more digits than the place has.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from s2r_spec.base.quantity import Scale
from s2r_spec.trace import Trace

T = TypeVar("T")

ROUNDING = 0.1
"""Tolerance: rounding moves an end by less than this part of the range's width."""
POINT = 0.01
"""Tolerance: a range of values narrower than this part of all that occur is printed as one value, "about 0 m/s"."""
DIGITS = 0.005
"""Definition: relative rounding error of a number that has no range: three significant digits."""
INSTANT = 0.01
"""Tolerance [s]: largest rounding error of an instant."""
EXPLAINS = 0.5
"""Tolerance: a difference of at least this part of the largest may be its cause, if it begins earlier."""


@dataclass(frozen=True)
class ValueRange:
    """Values of one quantity, in its unit.

    Attributes:
        low, high: the ends; ∓inf for none.
        unit: of both, as the specification writes it.
        name: the channel or the parameter; "" for time.
        lowest, highest: the ends of all values that occur at all; ∓inf if they are not known.
    """

    low: float
    high: float
    unit: str = "s"
    name: str = ""
    lowest: float = -math.inf
    highest: float = math.inf

    @property
    def extent(self) -> float:
        """Distance from the lowest to the highest value that occurs; inf if it is not known."""
        return self.highest - self.lowest

    @property
    def everything(self) -> bool:
        """Whether the range leaves out less than rounding does."""
        slack = ROUNDING * self.extent / 2 if math.isfinite(self.extent) else 0.0
        return self.low <= self.lowest + slack and self.high >= self.highest - slack

    def in_time(self) -> str:
        """Return "from 0.5 to 0.6 s", "at 1.86 s" or "throughout"."""
        if self.everything:
            return "throughout"
        if self.low == self.high:
            return f"at {_quantity(self.low, self.unit, min(DIGITS * abs(self.low), INSTANT))}"
        low, high, unit = self._ends()
        return f"from {low} to {high} {unit}"

    def in_values(self) -> str:
        """Return "q is between 0.1 and 0.12 m", "v is about 0 m/s" or "v is above 3 m/s"; "" for any value."""
        if self.everything:
            return ""
        if self.low == self.high:
            return f"{self.name} is {_quantity(self.low, self.unit, DIGITS * abs(self.low))}"
        if self._width < POINT * self.extent < math.inf:
            scale = Scale.of(self.extent, self.unit)
            middle = max(self.low, self.lowest) + self._width / 2
            about = _number(middle / scale.factor, POINT * self.extent / scale.factor)
            return f"{self.name} is about {about} {scale.unit}".rstrip()
        low, high, unit = self._ends()
        if self.low <= self.lowest:
            words = f"below {high}"
        elif self.high >= self.highest:
            words = f"above {low}"
        else:
            words = f"between {low} and {high}"
        return f"{self.name} is {words} {unit}".rstrip()

    @property
    def _width(self) -> float:
        """Width of the part of the range that occurs."""
        return min(self.high, self.highest) - max(self.low, self.lowest)

    def _ends(self) -> tuple[str, str, str]:
        """Return both ends, rounded to the width of the range, and their unit."""
        low, high = max(self.low, self.lowest), min(self.high, self.highest)
        scale = Scale.of(max(abs(end) for end in (low, high) if math.isfinite(end)), self.unit)
        finite = math.isfinite(self._width)
        errors = [ROUNDING * self._width if finite else DIGITS * abs(end) for end in (low, high)]
        first, last = (
            _number(end / scale.factor, error / scale.factor)
            for end, error in zip((low, high), errors, strict=True)
        )
        return first, last, scale.unit


@dataclass(frozen=True)
class Place:
    """A place in rollouts or in the test space.

    Attributes:
        time: from the start of a rollout [s]; None if time does not bound the place.
        part: of the machine, "FR calf"; "" for none.
        values: ranges of channels or of test parameters that hold together.
    """

    time: ValueRange | None = None
    part: str = ""
    values: tuple[ValueRange, ...] = ()

    def precedes(self, other: Place) -> bool:
        """Whether this place surely begins before another: windows show an onset to half of their length."""
        if self.time is None or other.time is None:
            return False
        middle = (self.time.low + self.time.high) / 2
        return self.time.low < other.time.low and middle <= other.time.low

    def __str__(self) -> str:
        """Return the place in words, time first: "from 0.5 to 0.6 s at FR calf, where q is between 0.1 and 0.12 m"."""
        values = " and ".join(filter(None, (one.in_values() for one in self.values)))
        when = "" if self.time is None else self.time.in_time()
        if when == "throughout" and values:
            when = ""
        first = " ".join(filter(None, (when, f"at {self.part}" if self.part else "")))
        return ", ".join(filter(None, (first, f"where {values}" if values else "")))


def instant(time: float) -> str:
    """Return a time from the start of a rollout [s] in words: "at 1.86 s"."""
    return ValueRange(time, time).in_time()


def cause_first(items: Sequence[T], place: Callable[[T], Place], strength: Callable[[T], float]) -> list[T]:
    """Return items with a difference, with the place where a difference begins before the places that react to it.

    In a closed loop a difference goes on after its cause, and the controller's reaction may be larger than the cause.
    So all that have at least :data:`EXPLAINS` of the largest strength come first, and none of them before one that
    surely begins earlier. Otherwise strength decides.

    Args:
        items: places with a difference.
        place: of each.
        strength: of each, on one scale; those of 0 keep their order.
    """
    by_strength = sorted(items, key=lambda one: -strength(one))
    least = EXPLAINS * max(map(strength, items), default=0.0)
    count = sum(strength(one) >= least > 0.0 for one in by_strength)
    large, ordered = by_strength[:count], []
    while large:
        places = [place(one) for one in large]
        late = next(k for k, one in enumerate(places) if not any(early.precedes(one) for early in places))
        ordered.append(large.pop(late))
    return ordered + by_strength[count:]


def find_visit(
    traces: Sequence[Trace], channel: str, column: int, low: float, high: float
) -> tuple[ValueRange | None, ValueRange]:
    """Return when one column of a channel has values above ``low`` up to ``high``, and these values.

    Times count from the start of each trace, from the first to the last such sample of all traces. They are None if no
    instant is within the times of every trace that has such values, because then time does not bound the place.
    """
    having = [trace for trace in traces if channel in trace.channels]
    unit = having[0].units.get(channel, "") if having else ""
    values = [trace[channel].reshape(len(trace), -1)[:, column] for trace in having]
    known = [part[np.isfinite(part)] for part in values if np.isfinite(part).any()]
    if not known:
        return None, ValueRange(low, high, unit, channel)
    lowest, highest = float(min(map(np.min, known))), float(max(map(np.max, known)))
    within = ValueRange(low, high, unit, channel, lowest, highest)
    clocks = [trace.times - trace.times[0] for trace in having]
    inside = [clock[(part > low) & (part <= high)] for clock, part in zip(clocks, values, strict=True)]
    begins, ends = ([float(times[end]) for times in inside if times.size] for end in (0, -1))
    if not begins or max(begins) > min(ends):
        return None, within
    longest = max(float(clock[-1]) for clock in clocks)
    return ValueRange(min(begins), max(ends), lowest=0.0, highest=longest), within


def _quantity(value: float, unit: str, error: float) -> str:
    """Return a value with its unit, rounded by less than ``error`` [unit]."""
    scale = Scale.of(value, unit)
    return f"{_number(value / scale.factor, error / scale.factor)} {scale.unit}".rstrip()


def _number(value: float, error: float) -> str:
    """Return a number without trailing zeros, rounded by less than ``error``."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:.0f}"
    decimals = math.floor(-math.log10(2.0 * error)) + 1
    digits = f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"
    return (digits.rstrip("0").rstrip(".") if "." in digits else digits).replace("-", "−")
