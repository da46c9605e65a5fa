"""Wait for a pipe with a time limit."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from time import monotonic, sleep
from typing import IO, Literal

Wait = Callable[[float], bool]
"""Waits at most this long [s] and returns whether the pipe is ready. A closed pipe is ready: a read returns its end."""


def waiter(file: IO[bytes], to: Literal["read", "write"]) -> Wait:
    """Make a pipe non-blocking, and return a function that waits for it."""
    if sys.platform == "win32":
        return _windows(file, to)
    import select

    os.set_blocking(file.fileno(), False)
    poll = select.poll()
    poll.register(file.fileno(), select.POLLIN if to == "read" else select.POLLOUT)
    # Rounded up: poll would take less than a millisecond as no wait at all.
    return lambda seconds: file.closed or bool(poll.poll(math.ceil(1000 * seconds)))


def _windows(file: IO[bytes], to: Literal["read", "write"]) -> Wait:
    """Return a function that polls a pipe for data every 5 ms; a write blocks, so a pipe is always ready for it."""
    if sys.platform != "win32":
        raise NotImplementedError
    import _winapi
    import msvcrt

    def wait(seconds: float) -> bool:
        end = monotonic() + seconds
        while to == "read" and not file.closed:
            try:
                if _winapi.PeekNamedPipe(msvcrt.get_osfhandle(file.fileno()), 0)[0]:
                    break
            except OSError:  # the other end is closed
                break
            if monotonic() >= end:
                return False
            sleep(0.005)
        return True

    return wait
