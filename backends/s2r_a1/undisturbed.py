"""Keep garbage collection and other processes from delaying a process that must act every 2 ms."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def undisturbed(first: bool) -> Iterator[None]:
    """Disable garbage collection in the block; ``first`` also requests real-time priority, if the system allows it.

    The collection at its beginning takes up to 0.3 s, so the block begins before a connection to a robot.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    restore = _real_time_priority() if first else None
    try:
        yield
    finally:
        if restore is not None:
            with suppress(OSError):
                os.sched_setscheduler(0, *restore)
        gc.enable()
        gc.unfreeze()


def _real_time_priority() -> tuple[int, os.sched_param] | None:
    """Set the lowest real-time priority, and return the old policy and priority; None if the system forbids it."""
    if not hasattr(os, "sched_setscheduler"):
        return None
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_min(os.SCHED_FIFO)))
    except OSError:
        return None
    return before
