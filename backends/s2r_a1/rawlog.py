"""Write and read the raw recording of a rollout: every packet in both directions, unchanged, and the guard's events.

A file is a magic line, a header as one line of JSON, and blocks, little-endian:

    u32 length of the records | u32 CRC-32 of length and records | records
    a record: u64 time [ns] | u8 direction | u16 length | bytes

Directions are 0 from the robot, 1 to the robot, and 2 for an event of the guard as JSON: its state and the reason.
Older recordings have no events.

A block without records ends a finished recording. An unfinished one (a killed process, a full disk) is read up to its
last complete block, which is at most 100 ms old. In lock step, times count rounds of 2 ms.
"""

from __future__ import annotations

import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import BackendError, TraceError

MAGIC = b"s2r a1log 1\n"
"""A definition: the first line of a recording."""
SUFFIX = ".a1log"
"""A definition: ending of a recording's file name."""
EVENT = 2
"""A definition: direction of a record with an event of the guard instead of a packet."""
BLOCK = 100_000_000
"""A budget [ns]: time of one block, which a kill may lose."""
BEHIND = 64 * 2**20
"""A budget [bytes]: data that wait in memory for a slow disk: a minute of packets in both directions."""

LONGEST = 65535
"""A definition: largest number of bytes of a record."""

_BLOCK = struct.Struct("<II")
_RECORD = struct.Struct("<QBH")


class RawLogError(BackendError):
    """A recording cannot be written."""


@dataclass(frozen=True, eq=False)
class RawLog:
    """A recording.

    Attributes:
        header: facts on the robot and the run.
        times: (n,) times of the packets [ns].
        directions: (n,) 0 from the robot, 1 to the robot.
        packets: the n packets, unchanged.
        finished: whether the recording was ended, and not cut off by a kill.
        events: events of the guard, oldest first, as on its control socket (:mod:`s2r_a1.guard.control`), each with
            its ``time`` [ns].
    """

    header: dict[str, Any]
    times: NDArray[np.uint64]
    directions: NDArray[np.uint8]
    packets: tuple[bytes, ...]
    finished: bool
    events: tuple[dict[str, Any], ...] = ()


class RawLogWriter:
    """Writes a recording from a separate thread, so that a slow disk never delays a round.

    Attributes:
        path: the file, which must not exist before.
        packets: number of packets so far.
        bytes: number of bytes on the disk so far.
        failure: a message after the disk refused a write; the thread tries again, and keeps the waiting data.
    """

    def __init__(self, path: str | os.PathLike[str], header: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self.packets = 0
        self.failure: str | None = None
        self.bytes = 0
        self._begun: int | None = None
        self._records = bytearray()
        self._waiting = bytearray(MAGIC + json.dumps(dict(header), ensure_ascii=False).encode() + b"\n")
        self._ending = False
        self._lost = False
        self._changed = threading.Condition()
        self._done = threading.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="raw log", daemon=True)
        self._thread.start()

    @property
    def ready(self) -> bool:
        """Whether the file exists with its header, or has failed."""
        return self._ready.is_set()

    @property
    def done(self) -> bool:
        """Whether the recording is finished and on the disk, or has failed for good."""
        return self._done.is_set()

    def wait_ready(self, seconds: float | None = None) -> bool:
        """Wait until the file exists or has failed; return ``ready``."""
        return self._ready.wait(seconds)

    def append(self, time: int, direction: int, packet: bytes) -> None:
        """Add a packet at a time [ns]; never waits for the disk, and never raises."""
        self._add(time, direction, packet)
        self.packets += 1

    def note(self, time: int, event: Mapping[str, Any]) -> None:
        """Add an event of the guard at a time [ns], and pass all data to the thread, since it may be the last event.

        An event that is too long for a record is left out without an error.
        """
        data = json.dumps(dict(event)).encode()
        if len(data) <= LONGEST:
            self._add(time, EVENT, data)
            self.flush()

    def _add(self, time: int, direction: int, data: bytes) -> None:
        if self._begun is not None and time - self._begun >= BLOCK:
            self.flush()
        if self._begun is None:
            self._begun = time
        self._records += _RECORD.pack(time, direction, len(data)) + data

    def flush(self) -> None:
        """Pass the appended records to the thread as one block; call it before a pause without packets."""
        if not self._records:
            return
        block, self._records, self._begun = self._records, bytearray(), None
        self._give(_block(block))

    def finish(self) -> None:
        """Request the last block and the flush to the disk without waiting; ``done`` shows the end."""
        self.flush()
        self._give(b"" if self._lost else _block(b""), ending=True)

    def close(self, seconds: float | None = None) -> Self:
        """Finish the recording, and wait for the disk.

        Raises:
            RawLogError: the disk did not accept everything within ``seconds``.
        """
        if not self._ending:
            self.finish()
        if not self._done.wait(seconds) or self.failure:
            raise RawLogError(
                self.failure
                or f"{self.path}: the recording is not on the disk yet; wait, or use a faster disk"
            )
        return self

    def _give(self, data: bytes | bytearray, ending: bool = False) -> None:
        with self._changed:
            if not self._lost and len(self._waiting) + len(data) <= BEHIND:
                self._waiting += data
            elif data:  # nothing is recorded after a gap
                self._lost = True
                self.failure = self.failure or (
                    f"{self.path}: the disk is too slow for the recording; "
                    f"end other programs that use it, or name another folder"
                )
            self._ending = self._ending or ending
            self._changed.notify()

    def _run(self) -> None:
        """Write all data until the end; the thread runs this."""
        try:
            file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
            try:
                self._serve(file)
            finally:
                os.close(file)
        except OSError as error:
            self._fail(error)
        finally:
            self._ready.set()
            self._done.set()

    def _serve(self, file: int) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._ending)
                ending, data = self._ending, bytes(self._waiting)
            taken = self._write(file, data)
            with self._changed:
                del self._waiting[:taken]
                more = len(self._waiting) > 0
            self._ready.set()
            if ending and (self.failure or not more):
                break
            if taken < len(data):
                with self._changed:  # a full disk is tried again with the next block, and at the end
                    self._changed.wait_for(lambda: self._ending, timeout=BLOCK / 1e9)
        os.fsync(file)
        folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)  # the name of the new file
        finally:
            os.close(folder)

    def _write(self, file: int, data: bytes) -> int:
        """Write as much as the disk accepts; return the number of bytes."""
        taken = 0
        while taken < len(data):
            try:
                taken += os.write(file, memoryview(data)[taken:])
            except OSError as error:
                self._fail(error)
                break
        self.bytes += taken
        return taken

    def _fail(self, error: OSError) -> None:
        self.failure = (
            f"{self.path}: the recording cannot be written: {error.strerror}; "
            f"free space on the disk, or use another disk"
        )


def read(path: str | os.PathLike[str]) -> RawLog:
    """Return a recording up to its last complete block.

    Raises:
        TraceError: the file cannot be read, or is not a recording; the message names it.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise TraceError(f"{os.fspath(path)}: {error.strerror}") from None
    if not data.startswith(MAGIC):
        raise TraceError(
            f"{os.fspath(path)} is not a raw recording of a robot; name a file that ends in {SUFFIX}"
        )
    line, newline, rest = data[len(MAGIC) :].partition(b"\n")
    header = _object(line) if newline else None
    if header is None:
        raise TraceError(f"{os.fspath(path)}: the header of the recording is damaged; use another recording")
    blocks = list(_blocks(rest))
    records = [record for block in blocks for record in _records(block)]
    packets = [record for record in records if record[1] != EVENT]
    events = [(time, _object(data)) for time, direction, data in records if direction == EVENT]
    return RawLog(
        header,
        np.array([time for time, _, _ in packets], np.uint64),
        np.array([direction for _, direction, _ in packets], np.uint8),
        tuple(packet for _, _, packet in packets),
        bool(blocks) and not blocks[-1],
        tuple({**event, "time": time} for time, event in events if event is not None),
    )


def _object(data: bytes) -> dict[str, Any] | None:
    """Return the object in a line of JSON; None for bad JSON, bad UTF-8, too many nested brackets, or another value."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def _block(records: bytes | bytearray) -> bytes:
    return _BLOCK.pack(len(records), _checksum(records)) + records


def _checksum(records: bytes | bytearray) -> int:
    """Return a CRC-32 that never matches a page of zeros, which a crash may leave on the disk."""
    return zlib.crc32(records, zlib.crc32(len(records).to_bytes(4, "little")))


def _blocks(data: bytes) -> Iterator[bytes]:
    """Yield the records of each block up to the first incomplete one; an empty block is the last."""
    place = 0
    while place + _BLOCK.size <= len(data):
        length, checksum = _BLOCK.unpack_from(data, place)
        place += _BLOCK.size
        block = data[place : place + length]
        if len(block) < length or _checksum(block) != checksum:
            return
        yield block
        if not block:
            return
        place += length


def _records(block: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield time [ns], direction and bytes of each packet of a block."""
    place = 0
    while place + _RECORD.size <= len(block):
        time, direction, length = _RECORD.unpack_from(block, place)
        place += _RECORD.size
        yield time, direction, block[place : place + length]
        place += length
