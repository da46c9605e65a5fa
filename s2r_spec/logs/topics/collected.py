"""The numbers of one topic's messages, as a bag gives them one after the other.

Elements of a message's vectors may have names, as the joints of a joint state. Several senders of one topic name
different elements. An element has the messages that name it and hold a value for it; elements that always come in the
same messages make one stream of messages, so a topic can give several.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, one_of
from s2r_spec.logs.library import reason_of
from s2r_spec.logs.table import Column
from s2r_spec.logs.topics.layout import Layout, layout
from s2r_spec.logs.topics.topic import Topic, jump_of

_BATCH = 4096
"""Budget: messages that are decoded together. Each takes a few hundred bytes until then."""
_BATCH_BYTES = 2**20
"""Budget: bytes of messages that are decoded together."""
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")


class Element:
    """Reads the element of a vector that has a name: its number, or None where the message lacks it."""

    def __init__(self, names: str, vector: str, name: str) -> None:
        self._names, self._vector, self._name = attrgetter(names), attrgetter(vector), name

    def __call__(self, message: Any) -> float | None:
        """Return the element of a message.

        Raises:
            TraceError: two elements have its name.
        """
        names, values = self._names(message), self._vector(message)
        if list(names).count(self._name) > 1:
            raise TraceError(
                f"a message has two elements that are called {self._name!r}; map one by its number"
            )
        place = names.index(self._name) if self._name in names else len(values)
        return float(values[place]) if place < len(values) else None


class NamedVector:
    """Reads a whole vector whose elements have names, and notices where the names change from message to message."""

    def __init__(self, names: str, vector: str) -> None:
        self._names, self._vector = attrgetter(names), attrgetter(vector)
        self._first: Sequence[str] | None = None
        self._changed = False

    def __call__(self, message: Any) -> Any:
        """Return the vector of a message."""
        names = self._names(message)
        if self._first is None:
            self._first = names
        self._changed = self._changed or names != self._first
        return self._vector(message)

    def fault(self, path: str) -> str:
        """Return why the vector has no meaning, as text after its name; "" if it has one."""
        if not self._changed or not self._first:
            return ""
        return f"has other elements from message to message; name one, such as {path}.{self._first[0]}"


@dataclass(frozen=True)
class Codec:
    """How the raw messages of a topic are decoded.

    Args:
        topic: its name.
        kind: type of the messages.
        store: rosbags' definitions of messages.
        cdr: whether they are in CDR, as in ROS 2.
        advice: what to do where they cannot be decoded, as text after the error.
    """

    topic: str
    kind: str
    store: Any
    cdr: bool
    advice: str = ""

    def message(self, raw: bytes, number: int) -> Any:
        """Return a message, which is one of the topic's, counted from 1.

        Raises:
            TraceError: it does not fit its type.
        """
        try:
            deserialize = self.store.deserialize_cdr if self.cdr else self.store.deserialize_ros1
            return deserialize(raw, self.kind)
        except Exception as error:  # of rosbags, or of what a wrong length leads to
            raise TraceError(
                f"message {number:,} of {self.topic} does not fit the definition of {self.kind}: "
                f"{reason_of(error)}{self.advice}"
            ) from None


class _Values:
    """Values of one field, (n,) or (n, k), in arrays of at most 8 bytes a number."""

    def __init__(self) -> None:
        self._parts: list[NDArray[Any]] = []
        self._lengths: set[int] = set()

    def extend(self, values: Any) -> int:
        """Add values, and return how many numbers they have."""
        if isinstance(values, np.ndarray):
            self._lengths |= {*values.shape[1:]}
        elif values and isinstance(values[0], np.ndarray):
            self._lengths |= {len(value) for value in values}
            if len(self._lengths) > 1:
                return sum(map(len, values))  # vectors of several lengths are no column
            values = np.stack(values)
        part = np.asarray(values)
        if len(self._lengths) <= 1 and len(part):
            self._parts.append(part)
        return part.size

    def array(self) -> NDArray[Any]:
        """Return all values, and forget them."""
        parts, self._parts = self._parts, []
        return np.concatenate(parts) if parts else np.zeros(0)

    def column(self, fault: str, kept: NDArray[Any] | slice) -> Column:
        """Return the values of the kept messages, and forget all."""
        if len(self._lengths) > 1:
            lengths = f"{min(self._lengths)} to {max(self._lengths)}"
            fault = fault or f"has vectors of {lengths} numbers, not of one length"
        return Column.without(fault) if fault else Column(self.array()[kept])


class Collected:
    """The messages of a topic that were added so far, of which only the numbers of chosen fields remain.

    Each field has a reader; ``stamped`` says whether the stamps are those of the headers.
    """

    def __init__(
        self, codec: Codec, fields: Sequence[str], readers: Sequence[Callable[[Any], Any]], stamped: bool
    ) -> None:
        self.count = self.numbers = 0
        self._codec, self._fields, self._readers, self._name = codec, fields, readers, codec.topic
        self._stamped = stamped
        self._elements = any(isinstance(reader, Element) for reader in readers)
        self._one_layout = not any(isinstance(reader, Element | NamedVector) for reader in readers)
        self._layout: Layout | None = None
        self._waiting: list[int] = []
        self._raw: list[bytes] = []
        self._bytes = 0
        self._stamps, self._ages, self._which = (_Values() for _ in range(3))
        self._age, self._last, self._unordered = 0, 0, False
        self._columns = [_Values() for _ in fields]
        self._patterns: dict[tuple[bool, ...], int] = {}

    def add(self, received: int, raw: bytes) -> bool:
        """Add a message, received at a time [ns], and return whether :attr:`numbers` changed.

        Raises:
            TraceError: it does not fit its type.
        """
        self.count += 1
        self._waiting.append(received)
        if self._fields or self._stamped:
            self._raw.append(raw)
            self._bytes += len(raw)
        if len(self._waiting) < _BATCH and self._bytes < _BATCH_BYTES:
            return False
        self._decode()
        return True

    def topics(self) -> tuple[dict[str, Topic], list[str]]:
        """Return the streams of messages by their names, with notes on messages that are not in them; forget all.

        A stream of some of the messages is named after its first field, and every :class:`Topic` after the topic.
        """
        self._decode()
        stamps = self._stamps.array().astype(np.int64, copy=False)
        ages = self._ages.array()
        which = self._which.array()
        received = stamps + np.rint(ages * 1e9).astype(np.int64) if self._stamped else stamps
        order = np.argsort(received, kind="stable") if self._unordered else stamps[:0]
        topics: dict[str, Topic] = {}
        notes: list[str] = []
        streams = self._streams()
        for occurring, numbers in streams.items():
            whole = len(occurring) == len(self._patterns)
            kept: slice | NDArray[Any] = slice(None) if whole else np.isin(which, [*occurring])
            if self._unordered:  # a recorder may write messages in another order than it received them
                kept = order if whole else order[np.isin(which[order], [*occurring])]
            fields = [self._fields[number] for number in numbers]
            name = self._name if whole or len(streams) == 1 else f"{self._name}.{fields[0]}"
            columns = {
                field: self._columns[number].column(self._fault(number), kept)
                for field, number in zip(fields, numbers, strict=True)
            }
            own = stamps[kept]
            dropped = {} if whole else {"no value of the element": len(stamps) - len(own)}
            age, jump = self._clock(own, ages[kept]) if self._stamped and len(own) else (None, None)
            topics[name] = Topic(self._name, own.view("M8[ns]"), columns, age, jump, dropped)
            if not whole:
                without = f"{len(stamps) - len(own):,} messages of {self._name} have no value"
                notes.append(f"{without} of {one_of(fields)}, and are left out there")
        return topics, notes

    def _clock(self, stamps: NDArray[np.int64], ages: NDArray[Any]) -> tuple[float, tuple[int, float] | None]:
        """Return the median age of header stamps, and where they jump ahead; a stamp of 0 was not set."""
        was_set = np.flatnonzero(stamps)
        jump = jump_of(ages[was_set])
        age = self._age * 1e-9 + float(np.median(ages))
        return age, jump and (int(was_set[jump[0]]), jump[1])

    def _streams(self) -> dict[frozenset[int], list[int]]:
        """Return the patterns of messages in which fields occur → the numbers of these fields."""
        everywhere = frozenset(self._patterns.values())
        streams: dict[frozenset[int], list[int]] = {}
        never = []
        for number in range(len(self._fields)):
            occurring = frozenset(which for pattern, which in self._patterns.items() if pattern[number])
            if occurring or not self._elements:
                streams.setdefault(occurring, []).append(number)
            else:
                never.append(number)
        streams.setdefault(next(iter(streams), everywhere), []).extend(never)
        return streams

    def _fault(self, number: int) -> str:
        """Return why a field cannot be read, as text after its name; "" if it can."""
        reader = self._readers[number]
        if isinstance(reader, NamedVector):
            return reader.fault(f"{self._name}.{self._fields[number]}")
        if isinstance(reader, Element) and not any(pattern[number] for pattern in self._patterns):
            return "has no value in any message"
        return ""

    def _decode(self) -> None:
        begin = self.count - len(self._waiting)
        waiting, raw = self._waiting, self._raw
        self._waiting, self._raw, self._bytes = [], [], 0
        if not waiting:
            return
        received = np.array(waiting, dtype=np.int64)
        self._unordered |= received[0] < self._last or bool((np.diff(received) < 0).any())
        self._last = int(received[-1])
        if not self._stamped:
            self.numbers += self._stamps.extend(received)
        if not raw:
            return
        columns = self._read_columns(raw, begin) if self._one_layout else None
        if columns is None:
            columns = self._one_by_one(raw, begin)
        if self._stamped:
            stamps = columns[-2].astype(np.int64) * 10**9 + columns[-1]
            self._age = self._age if begin else int(received[0] - stamps[0])
            self._ages.extend(((received - stamps - self._age) * 1e-9).astype(np.float32))
            self.numbers += self._stamps.extend(stamps)
        for values, column in zip(self._columns, columns, strict=False):
            self.numbers += values.extend(column)

    def _read_columns(self, raw: Sequence[bytes], begin: int) -> list[Any] | None:
        """Return the fields of messages with one layout, and their stamps; None if they have several."""
        fields = [*self._fields, *(_STAMP if self._stamped else ())]
        columns = self._layout.columns(raw, fields) if self._layout else None
        if columns is None:
            self._layout = self._check_layout(raw[0], fields, begin)
            columns = self._layout.columns(raw, fields) if self._layout else None
        return columns

    def _check_layout(self, raw: bytes, fields: Sequence[str], begin: int) -> Layout | None:
        """Return the layout of a message if it gives the values that rosbags decodes."""
        candidate = layout(self._codec.store, self._codec.kind, raw, self._codec.cdr)
        if candidate is None or not candidate.fields.keys() >= {*fields}:
            return None
        message = self._codec.message(raw, begin + 1)
        values = candidate.columns([raw], fields) or ()
        equal = (
            np.array_equal(value[0], attrgetter(field)(message), equal_nan=value.dtype.kind == "f")
            for field, value in zip(fields, values, strict=True)
        )
        return candidate if all(equal) else None

    def _one_by_one(self, raw: Sequence[bytes], begin: int) -> list[Any]:
        """Return the fields of messages and their stamps; the first has a number."""
        rows: list[list[Any]] = []
        readers = [*self._readers, *(map(attrgetter, _STAMP) if self._stamped else ())]
        for number, one in enumerate(raw, begin + 1):
            message = self._codec.message(one, number)
            rows.append([reader(message) for reader in readers])
        if self._elements:
            patterns = [tuple(value is not None for value in row) for row in rows]
            self._which.extend([self._patterns.setdefault(one, len(self._patterns)) for one in patterns])
            rows = [[np.nan if value is None else value for value in row] for row in rows]
        columns: list[Any] = [list(column) for column in zip(*rows, strict=True)]
        if self._stamped:
            columns[-2:] = [np.array(column, dtype=np.int64) for column in columns[-2:]]
        return columns
