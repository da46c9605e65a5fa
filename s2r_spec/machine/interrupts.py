"""Ctrl-C as an event to wait for: a KeyboardInterrupt would leave a machine in the middle of a motion."""

from __future__ import annotations

import signal
from queue import Empty, SimpleQueue
from threading import current_thread, main_thread
from types import FrameType
from typing import Any, Self

LOOK = 0.1
"""Budget: interval at which a wait looks for a Ctrl-C [s]: one just before a wait does not end it at once."""


class Interrupts:
    """Counts Ctrl-C instead of raising KeyboardInterrupt, in the main thread. A context manager.

    Attributes:
        count: number of Ctrl-C so far.
        events: queue with True for each Ctrl-C; other threads may add False for their own events.
    """

    def __init__(self) -> None:
        self.count = 0
        # A signal handler may call put() while get() waits.
        self.events: SimpleQueue[bool] = SimpleQueue()
        self._before: Any = None

    def __enter__(self) -> Self:
        if current_thread() is main_thread():
            self._before = signal.signal(signal.SIGINT, self._came)
        return self

    def __exit__(self, *error: object) -> None:
        if current_thread() is main_thread():
            signal.signal(signal.SIGINT, self._before)

    def next(self) -> bool:
        """Wait for the next event, and return it."""
        while True:
            try:
                return self.events.get(timeout=LOOK)
            except Empty:  # Python handles pending signals now
                continue

    def _came(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        self.events.put(True)
