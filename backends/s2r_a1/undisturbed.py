"""Keeps a process that must act every 2 ms from being held up by its own memory, or by other processes."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def undisturbed(first: bool) -> Iterator[None]:
    """Collect no garbage meanwhile; ``first`` also comes before other processes, where the system allows it."""
    gc.collect()
    gc.freeze()
    gc.disable()
    restore = _come_first() if first else None
    try:
        yield
    finally:
        if restore is not None:
            with suppress(OSError):
                os.sched_setscheduler(0, *restore)
        gc.enable()
        gc.unfreeze()


def _come_first() -> tuple[int, os.sched_param] | None:
    """Take the lowest priority in real time, and return what was there before; None where that cannot be."""
    if not hasattr(os, "sched_setscheduler"):
        return None
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_min(os.SCHED_FIFO)))
    except OSError:
        return None
    return before
