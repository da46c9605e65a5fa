"""Messages between s2r and a worker: every one carries the number of the call that it belongs to.

A message is a head (mark, number, length in bytes) and its data. Files are raw, without a buffer of Python's: that
has a lock, and a fork copies a lock that another thread holds.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from typing import IO

_HEAD = struct.Struct(">4sQQ")
_MARK = b"s2r\x01"
_AT_ONCE = 1 << 16  # bytes that are read at once: what a pipe of Linux holds


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


class Reader:
    """Reads messages from a file.

    Args:
        file: raw, opened for reading.
        ready: returns when a file that does not block has more, or raises.
    """

    def __init__(self, file: IO[bytes], ready: Callable[[], None] = _at_once) -> None:
        self._file, self._ready = file, ready
        self._held = bytearray()

    def read(self) -> tuple[int, bytes]:
        """Return number and data of the next message.

        Raises:
            EOFError: nobody writes any more, or the file was closed here.
            ForeignBytesError: what came is no message.
        """
        mark, number, size = _HEAD.unpack(self._take(_HEAD.size))
        if mark != _MARK:
            raise ForeignBytesError
        return number, self._take(size)

    def _take(self, size: int) -> bytes:
        while len(self._held) < size:
            if sys.platform == "win32":  # where a pipe always blocks
                self._ready()
            try:
                part: bytes | None = self._file.read(_AT_ONCE)
            except ValueError:  # it was closed here meanwhile
                raise EOFError from None
            if part is None:
                self._ready()
            elif part:
                self._held += part
            else:
                raise EOFError
        taken = bytes(self._held[:size])
        del self._held[:size]
        return taken
