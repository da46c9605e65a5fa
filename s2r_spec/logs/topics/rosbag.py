"""ROS 1 bags, ROS 2 bags and MCAP files of ROS 2 messages, read by ``rosbags`` (the extra ``logs``), without ROS.

Only messages of the chosen topics are decoded, one after the other, and only their chosen numbers are kept. A joint
state names its joints: ``/joint_states.position.FL_hip`` is the position of this joint in every message, whatever its
place there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.errors import TraceError, shortened
from s2r_spec.logs.library import library
from s2r_spec.logs.table import Column, affordable, few
from s2r_spec.logs.topics.topic import Stamps, Topic, TopicHead
from s2r_spec.printable import one_line

_NUMBERS = frozenset(
    (
        "bool",
        "byte",
        "char",
        "float32",
        "float64",
        "int8",
        "int16",
        "int32",
        "int64",
        "uint8",
        "uint16",
        "uint32",
        "uint64",
    )
)
"""Definition: the base types of ROS that are numbers."""
_TIMES = frozenset(("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"))
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
"""Definition: rosbags' numbers of the kinds of a field: a base type, a message, and vectors of either."""
_DEEPEST = 20
"""Budget: levels of messages within messages. Twice as many list deeper fields."""
_LOOKED_AT = 100
"""Budget: messages of a topic that are searched for names of elements. Twice as many find rarer senders."""
_HEADER = "header.stamp"
METADATA = "metadata.yaml"
"""Definition: the file that marks a folder as a ROS 2 bag."""
_NAMES = ("name", "names", "joint_names")
"""Definition: fields with the names of the elements of a message's vectors, as in ``sensor_msgs/JointState``."""


class _Element:
    """Reads the element of a vector that has a name: its number, or NaN where the message lacks it."""

    def __init__(self, names: str, vector: str, name: str) -> None:
        self._names, self._vector, self._name = attrgetter(names), attrgetter(vector), name

    def present(self, message: Any) -> bool:
        """Return whether the message has the element."""
        return self._name in self._names(message)

    def __call__(self, message: Any) -> float:
        names, values = self._names(message), self._vector(message)
        place = names.index(self._name) if self._name in names else len(values)
        return float(values[place]) if place < len(values) else np.nan


class _Vector:
    """Reads a whole vector whose elements have names, and notices where the names change from message to message."""

    def __init__(self, names: str, vector: str) -> None:
        self._names, self._vector = attrgetter(names), attrgetter(vector)
        self._first: Sequence[str] | None = None
        self._changed = False

    def __call__(self, message: Any) -> Any:
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


class RosBag:
    """A bag; see :class:`s2r_spec.logs.topics.topic.TopicLog`.

    Args:
        path: a ROS 1 ``.bag``, the folder of a ROS 2 bag, or its ``.db3`` or ``.mcap`` file.

    Raises:
        TraceError: rosbags is not installed, or the file is not a bag.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.sortable = True
        self.notes: list[str] = []
        with self._open() as bag:
            counts: dict[str, int] = defaultdict(int)
            kinds: dict[str, str] = {}
            for connection in bag.connections:
                counts[connection.topic] += connection.msgcount
                kinds.setdefault(connection.topic, connection.msgtype)
            few(len(kinds))
            heads = [_head(bag.typestore, topic, kind, counts[topic]) for topic, kind in kinds.items()]
            vectors = {head.name: _named_vectors(bag.typestore, head) for head in heads}
        self._elements: dict[tuple[str, str], _Element] = {}
        self._vectors: dict[tuple[str, str], str] = {}
        self.heads = tuple(self._with_elements(head, *vectors[head.name]) for head in heads)

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read fields of topics; see :meth:`s2r_spec.logs.topics.topic.TopicLog.read`."""
        counts = {head.name: head.count for head in self.heads if head.name in wanted}
        affordable(sum(counts[name] * (1 + len(fields)) for name, fields in wanted.items()))
        readers = {name: [self._reader(name, one) for one in fields] for name, fields in wanted.items()}
        elements = {
            name: [reader for reader in chosen if isinstance(reader, _Element)]
            for name, chosen in readers.items()
            if chosen and all(isinstance(reader, _Element) for reader in chosen)
        }
        others: dict[str, int] = defaultdict(int)
        taken = 0
        times: dict[str, list[int]] = {name: [] for name in wanted}
        values: dict[str, list[list[Any]]] = {name: [[] for _ in fields] for name, fields in wanted.items()}
        ages: dict[str, list[int]] = {name: [] for name in wanted}
        header = attrgetter(_HEADER)
        decode = {name for name, fields in wanted.items() if fields or stamps == "header"}
        for topic, received, message in self._messages(set(wanted), decode):
            if topic in elements and not any(element.present(message) for element in elements[topic]):
                others[topic] += 1
                continue
            stamp = _nanoseconds(header(message)) if stamps == "header" else received
            times[topic].append(stamp)
            ages[topic].append(received - stamp)
            for column, reader in zip(values[topic], readers[topic], strict=True):
                value = reader(message)
                taken += np.size(value)
                column.append(value)
            affordable(taken)
        self.notes += [
            f"{count} messages of {name} have no element that is read, and are left out"
            for name, count in others.items()
        ]
        return {
            name: Topic(
                name,
                np.array(times[name], dtype=np.int64).view("M8[ns]"),
                {
                    one: _column(column, reader.fault(f"{name}.{one}") if isinstance(reader, _Vector) else "")
                    for one, column, reader in zip(wanted[name], values[name], readers[name], strict=True)
                },
                np.array(ages[name], dtype=np.float64) * 1e-9 if stamps == "header" else None,
                {"no element that is read": others[name]} if name in others else {},
            )
            for name in wanted
        }

    def _with_elements(self, head: TopicHead, names: str, vectors: Sequence[str]) -> TopicHead:
        """Return a topic with a field for each named element of its vectors, by the names in its first messages."""
        if not (names and vectors and head.count):
            return head
        looked_at = islice(self._messages({head.name}, {head.name}), _LOOKED_AT)
        elements = dict.fromkeys(name for _, _, message in looked_at for name in getattr(message, names))
        fields = list(head.fields)
        for vector in vectors:
            self._vectors[head.name, vector] = names
            for name in elements:
                fields.append(f"{vector}.{name}")
                self._elements[head.name, fields[-1]] = _Element(names, vector, name)
        return replace(head, fields=tuple(fields))

    def _reader(self, topic: str, field: str) -> Callable[[Any], Any]:
        """Return what reads a field of a topic's messages."""
        if (topic, field) in self._elements:
            return self._elements[topic, field]
        names = self._vectors.get((topic, field))
        return attrgetter(field) if names is None else _Vector(names, field)

    def _messages(self, topics: set[str], decode: set[str]) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time of receipt [ns], message) of some topics, decoded for some of these."""
        with self._open() as bag:
            connections = [one for one in bag.connections if one.topic in topics]
            if not connections:
                return
            for connection, received, raw in bag.messages(connections=connections):
                decoded = bag.deserialize(raw, connection.msgtype) if connection.topic in decode else None
                yield connection.topic, received, decoded

    @contextmanager
    def _open(self) -> Iterator[Any]:
        self._path.stat()  # a missing file is no damaged bag
        highlevel = library("rosbags.highlevel", "ROS bags")
        typesys = library("rosbags.typesys", "ROS bags")
        with _errors(self._path):
            # Bags of ROS 2 before Iron have no definitions of their messages; those of ROS itself are then assumed.
            known = typesys.get_typestore(typesys.Stores.LATEST)
            with highlevel.AnyReader([self._path], default_typestore=known) as bag:
                yield bag


@contextmanager
def _errors(path: Path) -> Iterator[None]:
    """Turn whatever rosbags raises for a damaged bag into a TraceError; it has no common base class."""
    try:
        yield
    except (TraceError, FileNotFoundError, PermissionError):
        raise
    except Exception as error:
        reason = shortened(one_line(str(error)) or type(error).__name__)
        part = path.is_file() and (path.parent / METADATA).is_file()
        hint = f"; it is a part of a bag, so name the folder {path.parent}" if part else ""
        raise TraceError(f"this is not a complete ROS bag: {reason}{hint}") from None


def _head(store: Any, topic: str, kind: str, count: int) -> TopicHead:
    """Return the fields of a topic that are numbers, from the definition of its messages."""
    fields: list[str] = []
    faults: dict[str, str] = {}
    other: dict[str, str] = {}

    def visit(name: str, prefix: str, depth: int) -> None:
        for field, (shape, content) in store.get_msgdef(name).fields:
            path = f"{prefix}{field}"
            if shape == _NAME and content not in _TIMES and depth < _DEEPEST:
                visit(content, f"{path}.", depth + 1)
            elif shape == _BASE:
                if content[0] in _NUMBERS:
                    fields.append(path)
                else:
                    other[path] = "holds text, and s2r reads numbers"
            elif shape in (_ARRAY, _SEQUENCE) and content[0][0] == _BASE and content[0][1][0] in _NUMBERS:
                fields.append(path)
            elif shape in (_ARRAY, _SEQUENCE):
                held = "texts" if content[0][0] == _BASE else "messages"
                other[path] = f"is an array of {held}, and s2r reads numbers and arrays of numbers"
            elif content in _TIMES:
                other[path] = "is a time, and s2r reads numbers"

    try:
        visit(kind, "", 0)
        header = store.get_msgdef(kind).fields[0] == ("header", (_NAME, "std_msgs/msg/Header"))
    except KeyError:
        faults[""] = f"has messages of the type {kind}, whose definition the bag lacks"
        return TopicHead(topic, (), count, kind, False, faults=faults)
    return TopicHead(topic, tuple(fields), count, kind, header, other=other)


def _named_vectors(store: Any, head: TopicHead) -> tuple[str, tuple[str, ...]]:
    """Return the field with the names of a message's elements ("" if it has none), and its vectors of numbers."""
    if head.faults:
        return "", ()
    fields = store.get_msgdef(head.kind).fields
    names = [
        name
        for name, (shape, content) in fields
        if name in _NAMES and shape == _SEQUENCE and content[0] == (_BASE, ("string", 0))
    ]
    vectors = [name for name, (shape, _) in fields if name in head.fields and shape == _SEQUENCE]
    return (names[0] if names else ""), tuple(vectors)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _column(values: Sequence[Any], fault: str = "") -> Column:
    """Return (n,) numbers, or (n, k) where every message has a vector of the same length."""
    if fault:
        return Column.without(fault)
    if values and isinstance(values[0], np.ndarray):
        lengths = {len(value) for value in values}
        if len(lengths) > 1:
            return Column.without(
                f"has vectors of {min(lengths)} to {max(lengths)} numbers, not of one length"
            )
        return Column(np.stack(values))
    return Column(np.array(values))
