"""Keep garbage collection and other processes from delaying a process that must act every 2 ms."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def undisturbed(first: bool) -> Iterator[None]:
    """Disable garbage collection in the block; ``first`` also sets the lowest real-time priority if allowed."""
    gc.collect()
    gc.freeze()
    gc.disable()
    restore = None
    if first and hasattr(os, "sched_setscheduler"):
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        with suppress(OSError):
            lowest = os.sched_param(os.sched_get_priority_min(os.SCHED_FIFO))
            os.sched_setscheduler(0, os.SCHED_FIFO, lowest)
            restore = before
    try:
        yield
    finally:
        if restore is not None:
            with suppress(OSError):
                os.sched_setscheduler(0, *restore)
        gc.enable()
        gc.unfreeze()
