"""ROS 1 bags, ROS 2 bags and MCAP files of ROS 2 messages, read by ``rosbags`` (the extra ``logs``), without ROS.

Only messages of the chosen topics are decoded, and only their chosen numbers are kept. A joint
state names its joints: ``/joint_states.position.FL_hip`` is the position of this joint in every message, whatever its
place there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np

from s2r_spec.base.errors import TraceError
from s2r_spec.logs.library import library
from s2r_spec.logs.table import check_columns, check_size
from s2r_spec.logs.topics.collected import Codec, Collected, Element, NamedVector
from s2r_spec.logs.topics.formats import METADATA
from s2r_spec.logs.topics.layout import ARRAY, BASE, NAME, SEQUENCE
from s2r_spec.logs.topics.topic import Stamps, Topic, TopicHead

if TYPE_CHECKING:
    from s2r_spec.logs.topics.bag_files import Bag

_NUMBERS = {"bool", "byte", "char", "float32", "float64"}
_NUMBERS |= {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
"""Definition: the base types of ROS that are numbers."""
_TIMES = frozenset(("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"))
_DEEPEST = 20
"""Budget: levels of messages within messages."""
_LOOKED_AT = 100
"""Budget: messages of a topic that are searched for names of elements."""
_NAMES = ("name", "names", "joint_names")
"""Definition: fields with the names of the elements of a message's vectors, as in ``sensor_msgs/JointState``."""


class RosBag:
    """A ROS 1 ``.bag``, the folder of a ROS 2 bag, or its ``.db3`` or ``.mcap`` file, as a ``TopicLog``.

    Raises:
        TraceError: rosbags is not installed, or the file is not a bag.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.sortable = True
        part = path.is_file() and (path.parent / METADATA).is_file()
        self._advice = f"; the file is a part of a bag, so name the folder {path.parent}" if part else ""
        self._stack = ExitStack()
        finalize(self, self._stack.close)
        self._readers: dict[tuple[str, str], Callable[[], Callable[[Any], Any]]] = {}
        self._codecs: dict[str, Codec] = {}
        self._bag = self._open_bag(by_parts=False)
        self._listed, self._source = dict(self._bag.listed), self._bag.source
        try:
            self.heads: Sequence[TopicHead] = list(self._heads())
        except _DamagedError:
            self._bag = self._open_bag(by_parts=True)
            self.heads = list(self._heads())
        self.notes: list[str] = []

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read fields of topics; see :meth:`s2r_spec.logs.topics.topic.TopicLog.read`.

        A topic whose named elements come in different messages gives several streams, each a :class:`Topic` with the
        topic's name. They differ in their keys: the topic's name, or that of the first field of the stream.
        """
        counts = {head.name: head.count for head in self.heads}
        check_size(sum(counts[name] * (1 + len(fields)) for name, fields in wanted.items()))
        try:
            collected = self._collect(wanted, stamps)
            whole = all(one.count >= counts[name] for name, one in collected.items())
        except _DamagedError:
            whole = False
        if not whole and not self._bag.by_parts:
            self._bag = self._open_bag(by_parts=True)
            collected = self._collect(wanted, stamps)
        self.notes += self._bag.notes
        # Receipt of the bag's last message [ns]; a log ends then, on the clock of its stamps.
        received = max(int(file.end_time) for file in self._bag.reader.readers)
        read: dict[str, Topic] = {}
        for name, one in collected.items():
            listed = self._listed.get(name, one.count)
            if one.count != listed:
                fault = "the bag is incomplete: " if one.count < listed else ""
                self.notes.append(
                    f"{fault}{one.count:,} messages of {name} are read, and {self._source} lists {listed:,}"
                )
            streams, notes = one.topics()
            self.notes += notes
            for key, stream in streams.items():
                end = received - round((stream.age or 0.0) * 1e9)
                read[key] = replace(stream, log_end=np.datetime64(end, "ns")) if received > 0 else stream
        return read

    def _collect(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Collected]:
        collected = {}
        for name, fields in wanted.items():
            readers = [self._readers.get((name, field), partial(attrgetter, field))() for field in fields]
            collected[name] = Collected(self._codecs[name], fields, readers, stamps == "header")
        for topic, received, raw in self._messages(set(wanted)):
            if collected[topic].add(received, raw):
                check_size(sum(one.numbers for one in collected.values()))
        return collected

    def _heads(self) -> Iterator[TopicHead]:
        counts: dict[str, int] = defaultdict(int)
        kinds: dict[str, str] = {}
        others: dict[str, str] = {}
        for connection in self._bag.reader.connections:
            counts[connection.topic] += connection.msgcount
            if connection.msgtype != kinds.setdefault(connection.topic, connection.msgtype):
                others[connection.topic] = connection.msgtype
        check_columns(len(kinds))
        for topic, kind in kinds.items():
            codec, fault = self._codec(topic, kind)
            if topic in others:
                fault = f"has messages of the types {kind} and {others[topic]}"
            self._codecs[topic] = codec
            if fault:
                yield TopicHead(topic, (), counts[topic], kind, faults={"": fault})
                continue
            head = _head(codec.store, topic, kind, counts[topic])
            yield self._with_elements(codec.store, head)

    def _codec(self, topic: str, kind: str) -> tuple[Codec, str]:
        """Return how the messages of a topic are decoded, and why they cannot be, as text after its name."""
        reader = self._bag.reader
        bag = Codec(topic, kind, reader.typestore, reader.is2, self._advice)
        one = next(one for one in reader.connections if one.topic == topic)
        encoding = getattr(one.ext, "serialization_format", "cdr")
        if encoding != "cdr":
            return bag, f"has messages in the encoding {encoding}, and s2r reads those of ROS"
        if not reader.is2 or one.msgdef.data:
            return bag, ""
        raw = (message for _, _, message in self._messages({topic}))
        store, fault = self._definitions.find_definitions(kind, raw, self._bag.distribution)
        return replace(bag, store=store), fault

    def _with_elements(self, store: Any, head: TopicHead) -> TopicHead:
        """Return a topic with a field for each named element of its vectors, by the names in its first messages."""
        defined = () if head.faults else store.get_msgdef(head.kind).fields
        texts = [
            name
            for name, (shape, content) in defined
            if name in _NAMES and shape == SEQUENCE and content[0] == (BASE, ("string", 0))
        ]
        vectors = [name for name, (shape, _) in defined if name in head.fields and shape == SEQUENCE]
        if not (texts and vectors and head.count):
            return head
        names = texts[0]
        elements: dict[str, None] = {}
        try:
            for number, (_, _, raw) in enumerate(islice(self._messages({head.name}), _LOOKED_AT), 1):
                elements |= dict.fromkeys(getattr(self._codecs[head.name].message(raw, number), names))
        except _DamagedError:
            raise
        except TraceError as error:  # it concerns only those who read this topic
            return replace(head, faults={"": f"cannot be read: {error}"})
        fields = list(head.fields)
        for vector in vectors:
            self._readers[head.name, vector] = partial(NamedVector, names, vector)
            for name in elements:
                fields.append(f"{vector}.{name}")
                self._readers[head.name, fields[-1]] = partial(Element, names, vector, name)
        return replace(head, fields=tuple(fields))

    def _messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time of receipt [ns], raw message) of some topics."""
        connections = [one for one in self._bag.reader.connections if one.topic in topics]
        if not connections:
            return
        try:
            # One file or folder owns all of them, so that there is nothing to merge.
            for connection, received, raw in self._bag.owner.messages(connections):
                yield connection.topic, received, raw
        except Exception as error:  # rosbags' errors have no common base class
            raise _DamagedError(str(self._files.unreadable_error(self._path, error))) from None

    def _open_bag(self, by_parts: bool) -> Bag:
        self._path.stat()  # a missing file is no damaged bag
        library("rosbags.highlevel", "ROS bags")
        self._stack.pop_all().close()
        self._files = import_module("s2r_spec.logs.topics.bag_files")
        self._definitions = import_module("s2r_spec.logs.topics.definitions")
        return self._files.open_bag(self._path, self._stack, by_parts)  # type: ignore[no-any-return]


class _DamagedError(TraceError):
    """The files of a bag are damaged; some of their messages may be readable without an index."""


def _head(store: Any, topic: str, kind: str, count: int) -> TopicHead:
    fields: list[str] = []
    other: dict[str, str] = {}

    def visit(name: str, prefix: str, depth: int) -> None:
        for field, (shape, content) in store.get_msgdef(name).fields:
            path = f"{prefix}{field}"
            if shape == NAME and content not in _TIMES and depth < _DEEPEST:
                visit(content, f"{path}.", depth + 1)
            elif shape == BASE:
                if content[0] in _NUMBERS:
                    fields.append(path)
                else:
                    other[path] = "holds text, and s2r reads numbers"
            elif shape in (ARRAY, SEQUENCE) and content[0][0] == BASE and content[0][1][0] in _NUMBERS:
                fields.append(path)
            elif shape in (ARRAY, SEQUENCE):
                held = "texts" if content[0][0] == BASE else "messages"
                other[path] = f"is an array of {held}, and s2r reads numbers and arrays of numbers"
            elif content in _TIMES:
                other[path] = "is a time, and s2r reads numbers"

    try:
        visit(kind, "", 0)
        header = store.get_msgdef(kind).fields[0] == ("header", (NAME, "std_msgs/msg/Header"))
    except KeyError:
        fault = f"has messages of the type {kind}, whose definition the bag lacks"
        return TopicHead(topic, (), count, kind, faults={"": fault})
    return TopicHead(topic, tuple(fields), count, kind, header, other=other)
