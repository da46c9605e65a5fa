"""The whole records of a file of a bag that has no index, or a damaged one: MCAP and ROS 1.

    MCAP     chunks with the right checksum, an uncompressed last chunk up to where it is cut off, and other records
    ROS 1    the same; only compressed chunks have checksums

Import this module only with ``rosbags``.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag1, ConnectionExtRosbag2, MessageDefinition
from rosbags.interfaces import MessageDefinitionFormat as Format
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag1.reader import Header, RecordType, decompressors, normalize, read_uint32
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.rosbag2.storage_mcap import Schema, decompress, get_msgdef, get_qos, read_string
from rosbags.typesys.msg import normalize_msgtype

from s2r_spec.logs.times.dates import text

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x02, 0x0F
"""Definition: opcodes of MCAP, https://mcap.dev/spec. There is no record 0, so that zeros are a lost end."""
_REMEDIES = {".mcap": "mcap recover {}", ".bag": "rosbag reindex {}", ".db3": "sqlite3 {} .recover"}
"""Definition: command that saves what a damaged file holds, by its ending."""


def remedy(path: Path) -> str:
    """Return the command that saves what a damaged file holds."""
    return _REMEDIES.get(path.suffix.lower(), "file {}").format(path.name)


class _Message(NamedTuple):
    """A raw message: number of its connection, time of receipt [ns], bytes."""

    connection: int
    received: int
    data: bytes


@dataclass
class _Losses:
    """What a file without index lacks.

    Args:
        closed: whether the recorder wrote the end of the file.
        left_out: bytes of the file that are not read.
        damaged: (first, last) time of receipt [ns] in each damaged chunk.
    """

    closed: bool = False
    left_out: int = 0
    damaged: list[tuple[int, int]] = field(default_factory=list)


_Records = Iterator[Connection | _Message]


class Parts:
    """The whole records of a file, from begin to end; a storage of rosbags.

    Args:
        path: the file.
        magic: the bytes with which a file of its format begins.
        records: (stream, its end, what it lacks) → connections and messages.

    Attributes:
        count: number of its whole messages.
    """

    def __init__(
        self, path: Path, magic: bytes, records: Callable[[BinaryIO, int, _Losses], _Records]
    ) -> None:
        self.path, self._magic = path, magic
        self.metadata = ReaderMetadata(0, 2**63 - 1, 0, 0, None, None, None, None)
        self.connections: list[Connection] = []
        self._parser = records
        self._losses = _Losses()
        self.count = 0
        self._first, self._last = 2**63 - 1, 0

    def open(self) -> None:
        """Find the connections, and count their messages."""
        connections: dict[int, Connection] = {}
        counts: dict[int, int] = defaultdict(int)
        self._losses = _Losses()
        for record in self._records(self._losses):
            if isinstance(record, Connection):
                connections.setdefault(record.id, record)
            else:
                counts[record.connection] += 1
                self._first, self._last = min(self._first, record.received), max(self._last, record.received)
        self.connections = [one._replace(msgcount=counts[one.id], owner=self) for one in connections.values()]
        self.count = sum(one.msgcount for one in self.connections)
        # rosbags ends a file one nanosecond after its last message.
        self.metadata = self.metadata._replace(end_time=self._last + 1)

    def close(self) -> None:
        """Forget the connections."""
        self.connections = []

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield (connection, time of receipt [ns], raw message) in the order of the file."""
        by_id = {one.id: one for one in connections}
        for record in self._records(_Losses()):
            if isinstance(record, _Message) and record.connection in by_id:
                yield by_id[record.connection], record.received, record.data

    @property
    def notes(self) -> list[str]:
        """What is read of a file that is not complete."""
        losses, name = self._losses, self.path.name
        if losses.closed and not losses.left_out:
            return []
        fault = "is damaged" if losses.closed else "was not closed"
        span = (self._last - self._first) * 1e-9
        notes = [
            f"{name} {fault}: {self.count:,} messages ({span:.6g} s) until {_date(self._last)} are read, "
            f"{losses.left_out:,} bytes are not; `{remedy(self.path)}` may save more"
        ]
        return notes + [
            f"a damaged part of {name} is left out, with messages from {_date(first)} to {_date(last)}"
            for first, last in losses.damaged
        ]

    def _records(self, losses: _Losses) -> _Records:
        with self.path.open("rb") as stream:
            if stream.read(len(self._magic)) != self._magic:
                raise ValueError(f"the file does not begin with {self._magic!r}")
            yield from self._parser(stream, self.path.stat().st_size, losses)


def _date(stamp: int) -> str:
    return text(np.datetime64(stamp, "ns"))


def _mcap(stream: BinaryIO, end: int, losses: _Losses, schemas: dict[int, Schema] | None = None) -> _Records:
    schemas = {} if schemas is None else schemas
    held: list[Connection | _Message] = []  # a record before zeros is not whole: zeros may fill its end, too
    begin = stream.tell()
    while (at := stream.tell()) < end:
        head = stream.read(9)
        kind, size = head[0], int.from_bytes(head[1:], "little")
        if kind == 0 or (len(head) == 9 and kind == _MESSAGE and size < 22):
            losses.left_out += end - (begin if held else at)
            return
        yield from held
        held, begin = [], at
        if kind == _FOOTER:
            return
        losses.closed = losses.closed or kind == _DATA_END
        if kind == _CHUNK and len(head) == 9:
            yield from _mcap_chunk(stream, min(size, end - stream.tell()), size, losses, schemas)
        elif stream.tell() + size > end or len(head) < 9:
            losses.left_out += end - at
            return
        elif kind in (_SCHEMA, _CHANNEL, _MESSAGE):
            held = _mcap_record(kind, BytesIO(stream.read(size)), schemas)
        else:
            stream.seek(size, 1)
    yield from held


def _mcap_chunk(
    stream: BinaryIO, present: int, size: int, losses: _Losses, schemas: dict[int, Schema]
) -> _Records:
    """Yield the whole records of a chunk, of which some bytes may be missing at the end."""
    body = BytesIO(stream.read(present))
    times: tuple[int, int] | None = None
    try:
        first, last, length, checksum = struct.unpack("<QQQI", body.read(28))
        times = first, last
        compression = read_string(body)
        stored = int.from_bytes(body.read(8), "little")
        data = body.read(stored)
        if present == size or compression:
            data = decompress(data, compression, length, checksum)
    except Exception:  # whatever the libraries of compressions raise
        losses.left_out += 9 + present
        if times and present == size:
            losses.damaged.append(times)
        return
    yield from _mcap(BytesIO(data), len(data), losses, schemas)


def _mcap_record(kind: int, body: BytesIO, schemas: dict[int, Schema]) -> list[Connection | _Message]:
    number = int.from_bytes(body.read(2), "little")
    if kind == _SCHEMA:
        schemas[number] = Schema(number, read_string(body), read_string(body), read_string(body))
        return []
    if kind == _CHANNEL:
        schema = schemas.get(int.from_bytes(body.read(2), "little"))
        topic, encoding = read_string(body), read_string(body)
        metadata = body.read()[4:]
        try:
            definition = get_msgdef(schema)
        except KeyError:  # the messages of another world than ROS 2
            definition = MessageDefinition(Format.NONE, "")
        name, more = schema.name if schema else "", ConnectionExtRosbag2(encoding, get_qos(metadata))
        return [Connection(number, topic, name, definition, "", 0, more, None)]
    body.seek(4, 1)
    received = int.from_bytes(body.read(8), "little")
    body.seek(8, 1)
    return [_Message(number, received, body.read())]


def _ros1(stream: BinaryIO, end: int, losses: _Losses) -> _Records:
    """Yield the whole records of ROS 1 from here to an end.

    The last chunk of a recorder that was killed has the length 0, and its records follow.
    """
    while (at := stream.tell()) < end:
        inner: _Records | None = None
        try:
            header = Header.read(stream)
            kind, size = header.get_uint8("op"), read_uint32(stream)
            if kind == RecordType.CHUNK:
                inner = _ros1_chunk(stream.read(size), size, header.get_string("compression"), losses)
            elif stream.tell() + size > end:
                raise ValueError("the record is cut off")
            elif kind == RecordType.CONNECTION:
                inner = iter([_ros1_connection(header, stream.read(size))])
            elif kind == RecordType.MSGDATA:
                message = _Message(header.get_uint32("conn"), header.get_time("time"), stream.read(size))
                inner = iter([message])
            else:
                stream.seek(size, 1)
                losses.closed = losses.closed or kind == RecordType.CHUNK_INFO
        except (Ros1Error, ValueError):
            losses.left_out += end - at
            return
        yield from inner or ()


def _ros1_chunk(body: bytes, size: int, compression: str, losses: _Losses) -> _Records:
    """Yield the whole records of a chunk, of which some bytes may be missing at the end."""
    try:
        data = decompressors[compression](body) if body and len(body) == size else body
        if len(body) < size and compression != "none":
            raise ValueError("the chunk is cut off")
    except Exception:  # whatever the libraries of compressions raise
        losses.left_out += len(body)
        return
    yield from _ros1(BytesIO(data), len(data), losses)


def _ros1_connection(header: Header, body: bytes) -> Connection:
    # A record's data has the form of a header.
    more = Header.read(BytesIO(len(body).to_bytes(4, "little") + body))
    return Connection(
        header.get_uint32("conn"),
        normalize(header.get_string("topic")),
        normalize_msgtype(more.get_string("type")),
        MessageDefinition(Format.MSG, more.get_string("message_definition")),
        more.get_string("md5sum"),
        0,
        ConnectionExtRosbag1(None, None),
        None,
    )


BY_PARTS = {".mcap": (b"\x89MCAP0\r\n", _mcap), ".bag": (b"#ROSBAG V2.0\n", _ros1)}
"""Definition: the formats whose whole records can be read, by the ending of a file."""
