"""Locks of folders: one process at a time writes into each. The system releases the locks of a process that ends."""

from __future__ import annotations

import os
from pathlib import Path

LOCK = "lock"
"""Definition: the locked file in a folder."""

_locks: dict[Path, int] = {}  # locked folder → file descriptor


def lock(folder: Path, held: Exception) -> None:
    """Lock a folder until it is released; raise ``held`` if another process has locked it."""
    try:
        import fcntl
    except ImportError:  # not a POSIX system: there is no such lock
        return
    if folder.resolve() in _locks:
        return
    handle = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise held from error
    _locks[folder.resolve()] = handle


def release(folder: Path) -> None:
    """Release a folder for another process."""
    if (handle := _locks.pop(folder.resolve(), None)) is not None:
        os.close(handle)
