"""A log of several topics, the same for every format.

Data: topics with nᵢ messages, each with a stamp and the values of its fields. A field is named after its topic,
``/odom.twist.twist.linear.x``. Stamps of one log have one type: ``datetime64[ns]`` for dates, ``timedelta64[ns]`` for
a clock without a date, or float64 seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from s2r_spec.logs.table import Column

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
    """

    name: str
    stamps: NDArray[Any]
    columns: Mapping[str, Column]
    age: float | None = None

    def __len__(self) -> int:
        return len(self.stamps)

    def ordered(self) -> tuple[Topic, int]:
        """Return the topic with strictly increasing stamps, and the number of messages left out.

        Of messages with the same stamp the last in the file remains.
        """
        order = np.argsort(self.stamps, kind="stable")
        stamps = self.stamps[order]
        last = np.append(stamps[1:] != stamps[:-1], True) if len(stamps) else np.zeros(0, dtype=bool)
        kept = order[last]
        return self.only(kept), len(self) - len(kept)

    def only(self, kept: NDArray[Any]) -> Topic:
        """Return some of the messages, by their numbers or as a mask."""
        columns = {
            name: Column(
                one.values[kept] if not one.fault else one.values,
                None if one.missing is None else one.missing[kept],
                one.fault,
            )
            for name, one in self.columns.items()
        }
        return Topic(self.name, self.stamps[kept], columns, self.age)


class TopicLog(Protocol):
    """A parsed log."""

    @property
    def heads(self) -> Sequence[TopicHead]:
        """The topics in the order of the file."""

    @property
    def notes(self) -> Sequence[str]:
        """Sentences on messages that were left out."""

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read fields of topics, and nothing else.

        Args:
            wanted: topic → names of its fields; a topic may have none, for its stamps alone.
            stamps: which stamps count, where the format has both.

        Raises:
            TraceError: the file is damaged.
        """
