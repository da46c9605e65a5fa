"""Bring topics to the stamps of one of them, the clock.

Data: topics i with stamps t_i1 < t_i2 < … and values y_ik. Result at a stamp t of the clock:

    hold     y_ik of the last message with t_ik ≤ t, as a controller sees a topic
    linear   between the messages before and after t

A command steps, so that fields of test parameters and of a condition are held under either rule, as truth values are.
Nothing is extrapolated to the past. The result begins when every topic has had a message; or, if ``early``, with the
clock's first stamp, and a topic has no value before its first message. It ends with the first interpolated topic that
ends. The notes say which clock, which rule, and for how long a value was held.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from s2r_spec import stamps
from s2r_spec.errors import TraceError, one_of, suggest
from s2r_spec.logs.dates import text
from s2r_spec.logs.table import Arrivals, Column
from s2r_spec.logs.topics.topic import Stamps, Topic
from s2r_spec.samples import Rule

RULES: tuple[Rule, ...] = get_args(Rule)
FloatArray = NDArray[np.float64]
NANOSECOND = Fraction(1, 10**9)


@dataclass(frozen=True)
class Joining:
    """How topics come to common stamps.

    Args:
        clock: name of the topic whose stamps the trace has; None for the one with the most messages.
        rule: values of the other topics at these stamps: "hold" or "linear".
        stamps: which stamps of a message count; None for those of the headers if all topics have one, else the
            times of receipt.
        held: fields that are held whatever the rule, by their names in the log.
    """

    clock: str | None = None
    rule: Rule = "hold"
    stamps: Stamps | None = None
    held: frozenset[str] = frozenset()

    def interpolates(self, topic: str, field: str) -> bool:
        """Return whether a field of a topic other than the clock is interpolated."""
        path = field if topic in ("", field) else f"{topic}.{field}"
        return self.rule == "linear" and not {path, path.rpartition("[")[0]} & self.held


class Joined(NamedTuple):
    """Topics at common stamps.

    Args:
        stamps: (n,) stamps.
        columns: (topic, field) → its column.
        notes: notes for the user.
        arrivals: topic → when its messages came.
    """

    stamps: NDArray[Any]
    columns: dict[tuple[str, str], Column]
    notes: list[str]
    arrivals: dict[str, Arrivals]


def join(topics: Mapping[str, Topic], joining: Joining, early: bool = False) -> Joined:
    """Return all fields of topics at the stamps of the clock.

    Args:
        topics: name → topic.
        joining: the clock and the rule.
        early: whether to keep stamps before the first message of a topic, where its values are missing.

    Raises:
        TraceError: the clock is not one of the topics, a topic has no messages, or the topics do not overlap.
    """
    notes: list[str] = []
    ordered: dict[str, Topic] = {}
    for name, topic in topics.items():
        ordered[name], repeated = topic.ordered()
        if not len(topic):
            raise TraceError(f"{_named(name)} has no messages")
        if repeated:
            notes.append(
                f"{repeated} messages of {_named(name)} have the stamp of a later one and are left out"
            )
    clock = _clock(ordered, joining.clock)
    grid = ordered[clock].stamps
    known = grid >= max(topic.stamps[0] for topic in ordered.values())
    kept = known | early
    between = {
        name: [
            field
            for field, column in topic.columns.items()
            if name != clock and _numeric(column) and joining.interpolates(topic.name, field)
        ]
        for name, topic in ordered.items()
    }
    if any(between.values()):
        kept &= grid <= min(topic.stamps[-1] for name, topic in ordered.items() if between[name])
    if not (kept & known).any():
        raise TraceError(f"the topics have no time in common: {_ranges(ordered)}; their clocks may differ")
    if len(grid) != kept.sum():
        notes.append(
            f"{len(grid) - int(kept.sum())} messages of {_named(clock)} are left out, because another topic has none "
            f"{'around' if any(between.values()) else 'before'} them"
        )
    grid = grid[kept]
    columns: dict[tuple[str, str], Column] = {}
    held: list[str] = []
    arrivals: dict[str, Arrivals] = {}
    for name, topic in ordered.items():
        at = np.searchsorted(topic.stamps, grid, side="right") - 1
        age = np.where(at < 0, np.nan, seconds(grid - topic.stamps[np.maximum(at, 0)]))
        if name == clock:
            age = np.concatenate([np.zeros(1), seconds(np.diff(grid))])
        elif len(between[name]) < max(len(topic.columns), 1):
            held.append(f"{_named(name)} is held, for at most {np.nanmax(age):.3g} s")
        else:
            held.append(f"{_named(name)} is interpolated")
        period = float(np.median(seconds(np.diff(topic.stamps)))) if len(topic) > 1 else 0.0
        arrivals[name] = Arrivals(period, age, name == clock)
        for field, column in topic.columns.items():
            columns[name, field] = (
                _between(column, topic.stamps, grid, at) if field in between[name] else _at(column, at)
            )
    if held:
        notes.append(f"the trace has the {len(grid)} stamps of {_named(clock)}; {', '.join(held)}")
    return Joined(grid, columns, notes, arrivals)


def _clock(topics: Mapping[str, Topic], chosen: str | None) -> str:
    if chosen is None:
        return max(topics, key=lambda name: len(topics[name]))
    if chosen not in topics:
        raise TraceError(
            f"the clock {chosen!r} is not one of the topics that are read{suggest(chosen, topics)} "
            f"they are {one_of(topics)}"
        )
    return chosen


def _at(column: Column, at: NDArray[np.int64]) -> Column:
    """Return the values of messages; a value is missing where the number of the message is negative."""
    if column.fault:
        return column
    missing = at < 0 if column.missing is None else (at < 0) | column.missing[at]
    return Column(column.values[at], missing if missing.any() else None)


def _numeric(column: Column) -> bool:
    """Return whether values can be interpolated: truth values and dates cannot."""
    return not column.fault and column.missing is None and column.values.dtype.kind in "iuf"


def _between(column: Column, own: NDArray[Any], grid: NDArray[Any], at: NDArray[np.int64]) -> Column:
    """Return values (n,) or (n, k) between the messages before and after each stamp."""
    before, after = np.maximum(at, 0), np.minimum(at + 1, len(own) - 1)
    width = seconds(own[after] - own[before])
    part = np.divide(seconds(grid - own[before]), width, out=np.zeros(len(grid)), where=width > 0)
    part = part.reshape(-1, *(1,) * (column.values.ndim - 1))
    values = column.values.astype(np.float64)
    missing = at < 0
    return Column((1.0 - part) * values[before] + part * values[after], missing if missing.any() else None)


def seconds(durations: NDArray[Any]) -> FloatArray:
    """Return differences of stamps in seconds."""
    if durations.dtype.kind == "m":
        return stamps.counted(durations.view(np.int64), NANOSECOND)
    return np.asarray(durations, dtype=np.float64)


def _named(topic: str) -> str:
    return topic or "the file"


def _ranges(topics: Mapping[str, Topic]) -> str:
    """Return the first and last stamp of each topic, as text."""
    return ", ".join(
        f"{_named(name)} from {stamp_text(topic.stamps[0])} to {stamp_text(topic.stamps[-1])}"
        for name, topic in topics.items()
    )


def stamp_text(stamp: Any) -> str:
    """Return a date, or seconds, as text."""
    if isinstance(stamp, np.datetime64):
        return text(stamp)
    return f"{float(seconds(np.array([stamp]))[0]):.12g} s"
