"""Messages between s2r and a worker; each carries the number of its call.

A message is a header (mark, number, length in bytes) and its data. The files are raw, without Python's buffer: a fork
would copy the buffer's lock while another thread holds it.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from typing import IO

_HEAD = struct.Struct(">4sQQ")
_MARK = b"s2r\x01"
_CHUNK = 1 << 16  # bytes of one read: the capacity of a pipe on Linux


class ForeignBytesError(Exception):
    """The bytes read are not a message: something else wrote into the pipe."""


def write(file: IO[bytes], number: int, data: bytes, ready: Callable[[], None] = lambda: None) -> None:
    """Write one message with the number of its call to a raw file.

    ``ready`` returns when a non-blocking file accepts more data, or raises an error.

    Raises:
        BrokenPipeError: the reader has closed the pipe.
        EOFError: this process has closed the file.
    """
    left = memoryview(_HEAD.pack(_MARK, number, len(data)) + data)
    while left:
        try:
            taken = file.write(left)
        except ValueError:
            raise EOFError from None  # another thread has closed the file
        if taken:
            left = left[taken:]
        else:  # a non-blocking file
            ready()


class Reader:
    """Reads messages from a raw file; ``ready`` returns when a non-blocking file has data, or raises an error."""

    def __init__(self, file: IO[bytes], ready: Callable[[], None] = lambda: None) -> None:
        self._file, self._ready = file, ready
        self._buffer = bytearray()

    def read(self) -> tuple[int, bytes]:
        """Return the number and the data of the next message.

        A closed pipe is an EOFError, and other bytes are a ForeignBytesError.
        """
        mark, number, size = _HEAD.unpack(self._take(_HEAD.size))
        if mark != _MARK:
            raise ForeignBytesError
        return number, self._take(size)

    def _take(self, size: int) -> bytes:
        while len(self._buffer) < size:
            if sys.platform == "win32":  # a pipe always blocks there
                self._ready()
            try:
                part: bytes | None = self._file.read(_CHUNK)
            except ValueError:  # another thread has closed the file
                raise EOFError from None
            if part is None:
                self._ready()
            elif part:
                self._buffer += part
            else:
                raise EOFError
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken
