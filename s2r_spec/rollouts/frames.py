"""Messages between s2r and a worker: every one carries the number of the call that it belongs to.

A message is a head (mark, number, length in bytes) and its data. Files are raw, without a buffer: a buffer has a
lock, and a fork copies a lock that another thread holds.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import IO

_HEAD = struct.Struct(">4sQQ")
_MARK = b"s2r\x01"
_LARGEST = 1 << 20
"""Budget: bytes that one call of the system may read. Half of it doubles the calls for long traces."""


class ForeignBytesError(Exception):
    """What was read is no message: something else wrote into the pipe."""


def _at_once() -> None:
    """Wait for nothing: reading and writing block by themselves."""


def write(file: IO[bytes], number: int, data: bytes, ready: Callable[[], None] = _at_once) -> None:
    """Write one message.

    Args:
        file: raw, opened for writing.
        number: of the call.
        data: any bytes.
        ready: returns when a file that does not block takes more, or raises.

    Raises:
        BrokenPipeError: nobody reads any more.
        EOFError: the file was closed here.
    """
    left = memoryview(_HEAD.pack(_MARK, number, len(data)) + data)
    while left:
        try:
            taken = file.write(left)
        except ValueError:
            raise EOFError from None  # it was closed here meanwhile
        if taken:
            left = left[taken:]
        else:  # only of a file that does not block
            ready()


def read(file: IO[bytes], ready: Callable[[], None] = _at_once) -> tuple[int, bytes]:
    """Return number and data of the next message.

    Args:
        file: raw, opened for reading.
        ready: returns when there is something to read, or raises.

    Raises:
        EOFError: nobody writes any more.
        ForeignBytesError: what came is no message.
    """
    mark, number, size = _HEAD.unpack(_exactly(file, _HEAD.size, ready))
    if mark != _MARK:
        raise ForeignBytesError
    return number, _exactly(file, size, ready)


def _exactly(file: IO[bytes], size: int, ready: Callable[[], None]) -> bytes:
    parts = []
    while size:
        ready()
        try:
            part = file.read(min(size, _LARGEST))
        except ValueError:  # it was closed here meanwhile
            part = b""
        if not part:
            raise EOFError
        parts.append(part)
        size -= len(part)
    return b"".join(parts)
