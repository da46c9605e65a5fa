"""Wait for a pipe, for no longer than some seconds."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from time import monotonic, sleep
from typing import IO, Literal

Wait = Callable[[float], bool]
"""Waits for a pipe for some seconds [s], and says whether it is ready. One that was closed is: that is read."""


def waits_for(file: IO[bytes], to: Literal["read", "write"]) -> Wait:
    """Return what waits for a pipe, which does not block from now on."""
    if sys.platform == "win32":
        return _windows(file, to)
    import select

    os.set_blocking(file.fileno(), False)
    poll = select.poll()
    poll.register(file.fileno(), select.POLLIN if to == "read" else select.POLLOUT)
    # Rounded up: less than a millisecond would be none.
    return lambda seconds: file.closed or bool(poll.poll(math.ceil(1000 * seconds)))


def _windows(file: IO[bytes], to: Literal["read", "write"]) -> Wait:
    """Return what looks every 5 ms whether there is something to read; writing blocks, and is always ready."""
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
            except OSError:  # its other end is closed
                break
            if monotonic() >= end:
                return False
            sleep(0.005)
        return True

    return wait
