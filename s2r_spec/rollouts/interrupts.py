"""Ctrl-C as something to wait for, where KeyboardInterrupt would leave a machine in the middle of a motion."""

from __future__ import annotations

import signal
from queue import Empty, SimpleQueue
from threading import current_thread, main_thread
from types import FrameType, TracebackType
from typing import Any, Self

LOOK = 0.1
"""Budget: how often a wait looks for a Ctrl-C [s]. One that comes just before the wait begins does not end it; twice as
much notices it later by as much."""


class Interrupts:
    """Counts Ctrl-C, instead of raising KeyboardInterrupt, where this thread may say so. A context manager.

    Attributes:
        count: how often it came.
        events: True for each; others may put what they wait for beside it.
    """

    def __init__(self) -> None:
        self.count = 0
        # Its put may be called in a signal handler while its get waits.
        self.events: SimpleQueue[bool] = SimpleQueue()
        self._before: Any = None

    def __enter__(self) -> Self:
        if current_thread() is main_thread():
            self._before = signal.signal(signal.SIGINT, self._came)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        if current_thread() is main_thread():
            signal.signal(signal.SIGINT, self._before)

    def next(self) -> bool:
        """Wait for the next event, and return it."""
        while True:
            try:
                return self.events.get(timeout=LOOK)
            except Empty:  # signals that are pending are handled now
                continue

    def _came(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        self.events.put(True)
