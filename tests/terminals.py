"""A terminal of a test's own: what a person sees on it, and types."""

from __future__ import annotations

import os
import pty
import select
import time
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE = 240.0
"""Seconds until what is expected must be there: a safety net, for the machine may be busy."""


class Person:
    """Sits at a pseudo-terminal; ``name`` is its other end, for the process that is watched."""

    def __init__(self, end: int, name: str) -> None:
        self._end, self.name = end, name
        self.seen = ""

    def reads(self, text: str, times: int = 1) -> str:
        """Wait until a text was shown so often since the last call; return what was shown up to it."""
        until = time.monotonic() + PATIENCE
        while self.seen.count(text) < times:
            ready, _, _ = select.select([self._end], [], [], max(0.0, until - time.monotonic()))
            assert ready, f"no {text!r} in {self.seen!r}"
            try:
                part = os.read(self._end, 65536)
            except OSError as error:  # the other end is closed
                raise AssertionError(f"no {text!r} in {self.seen!r}") from error
            self.seen += part.decode(errors="replace").replace("\r\n", "\n")
        place = 0
        for _ in range(times):
            place = self.seen.index(text, place) + len(text)
        shown, self.seen = self.seen[:place], self.seen[place:]
        return shown

    def rest(self) -> str:
        """Return what was shown since the last call, and do not wait for more."""
        while select.select([self._end], [], [], 0.0)[0]:
            try:
                self.seen += os.read(self._end, 65536).decode(errors="replace").replace("\r\n", "\n")
            except OSError:  # the other end is closed
                break
        shown, self.seen = self.seen, ""
        return shown

    def types(self, text: str) -> None:
        """Type a text; ``\\n`` is Enter, ``\\x04`` the end of input, ``\\x03`` Ctrl-C."""
        os.write(self._end, text.encode())

    def leaves(self) -> None:
        """Close the terminal, as a window is."""
        if self._end >= 0:
            os.close(self._end)
            self._end = -1


@contextmanager
def person() -> Iterator[Person]:
    """Open a terminal, and close it at the end."""
    end, other = pty.openpty()
    try:
        someone = Person(end, os.ttyname(other))
        yield someone
    finally:
        someone.leaves()
        os.close(other)
