"""A log of several topics, the same for every format.

Data: topics with nᵢ messages, each with a stamp and the values of its fields. A field is named after its topic,
``/odom.twist.twist.linear.x``. Stamps of one log have one type: ``datetime64[ns]`` for dates, ``timedelta64[ns]`` for
a clock without a date, or float64 seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.logs.table import Column
from s2r_spec.logs.times.dates import text
from s2r_spec.trace import stamps as exact

NANOSECOND = Fraction(1, 10**9)
APART = 1.0
"""Tolerance [s]: difference of the ages of stamps when they are recorded. Stamps that differ by more come from two
clocks, or from a clock that was set: no buffer on a robot holds a message for a second."""

Stamps = Literal["header", "received"]
STAMPS: tuple[Stamps, ...] = get_args(Stamps)
"""Which stamps of a message count: those its sender wrote into its header, or the times at which it was recorded."""


@dataclass(frozen=True)
class TopicHead:
    """What a log says of a topic before its messages are read.

    Args:
        name: name of the topic; "" for the arrays of a file without topics.
        fields: names of the fields that hold numbers, below the topic's name.
        count: number of messages.
        kind: type of the messages as the format calls it; "" if it has none.
        header: whether its messages carry the stamp of their sender.
        units: field → unit as written.
        faults: field → why it cannot be read.
        other: field that holds no numbers → what it holds, as text after its name.
    """

    name: str
    fields: tuple[str, ...]
    count: int
    kind: str = ""
    header: bool = False
    units: Mapping[str, str] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)
    other: Mapping[str, str] = field(default_factory=dict)

    def path(self, field_name: str) -> str:
        """Return the name of a field in the log; "" stands for the whole topic."""
        return f"{self.name}.{field_name}" if self.name and field_name else self.name or field_name


@dataclass(frozen=True)
class Topic:
    """The messages of a topic.

    Args:
        name: name of the topic.
        stamps: (n,) stamps, as the log has them, in the order of the file.
        columns: field → (n,) or (n, k) values.
        age: median time from a stamp to its receipt [s]; None if the stamps are the times of receipt.
        jump: the first stamp that jumps ahead of its receipt, see :func:`jump_of`; None if none does.
        dropped: reason → messages of the topic that are not among these.
        log_end: stamp at which the log ends, on the clock of these stamps; None if it is not known.
    """

    name: str
    stamps: NDArray[Any]
    columns: Mapping[str, Column]
    age: float | None = None
    jump: tuple[int, float] | None = None
    dropped: Mapping[str, int] = field(default_factory=dict)
    log_end: Any = None

    def __len__(self) -> int:
        return len(self.stamps)

    def only(self, kept: NDArray[Any]) -> Topic:
        """Return some of the messages, by their numbers or as a mask."""
        columns = {name: one if one.fault else one.only(kept) for name, one in self.columns.items()}
        return replace(self, stamps=self.stamps[kept], columns=columns)


class TopicLog(Protocol):
    """A parsed log.

    Attributes:
        heads: the topics in the order of the file.
        sortable: whether its stamps are of messages, which may come late; those of a table stand in its order.
        notes: sentences on messages that were left out.
    """

    heads: Sequence[TopicHead]
    sortable: bool
    notes: list[str]

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read fields of topics, by topic → their names; a topic may have none, for its stamps alone.

        Raises:
            TraceError: the file is damaged.
        """


def jump_of(ages: NDArray[Any]) -> tuple[int, float] | None:
    """Return the first message whose stamp is far ahead of those before, and by how much [s]; None if there is none.

    Args:
        ages: (n,) time from each stamp to its receipt [s], to within a constant.
    """
    if len(ages) < 3:
        return None
    least = np.minimum.accumulate(ages)[1:-1]
    # One old message at the begin, as of a latched topic, is no clock that was set.
    steady = np.abs(np.diff(ages[:-1])) <= APART
    jumps = np.flatnonzero(steady & (ages[2:] < least - APART)) + 2
    return (int(jumps[0]), float(ages[jumps[0] - 1] - ages[jumps[0]])) if jumps.size else None


def seconds(durations: NDArray[Any]) -> FloatArray:
    """Return differences of stamps in seconds."""
    if durations.dtype.kind == "m":
        return exact.to_seconds(durations.view(np.int64), NANOSECOND)
    return np.asarray(durations, dtype=np.float64)


def stamp_text(stamp: Any) -> str:
    """Return a date, or seconds, as text."""
    if isinstance(stamp, np.datetime64):
        return text(stamp)
    return f"{float(seconds(np.array([stamp]))[0]):.12g} s"
