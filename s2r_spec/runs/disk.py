"""Files of a run on the disk: written with a flush, and with errors that name them."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from s2r_spec import logs
from s2r_spec.base.errors import TraceError
from s2r_spec.runs.lines import JournalError
from s2r_spec.trace import Trace


@contextmanager
def naming_errors(what: str, remedy: Callable[[], str] = str) -> Iterator[None]:
    """Turn an error of the disk into a JournalError; the remedy is asked for only then."""
    try:
        yield
    except OSError as error:
        raise JournalError(f"cannot {what}: {error.strerror or error}{remedy()}") from error


def checksum(path: Path) -> str:
    """Return the CRC-32 of a file, as hex digits."""
    total = 0
    with path.open("rb") as file:
        while part := file.read(1 << 20):
            total = zlib.crc32(part, total)
    return f"{total:08x}"


def append(path: Path, line: bytes) -> None:
    """Append a line to a file, and flush it to the disk."""
    start = path.stat().st_size if path.exists() else 0
    with path.open("ab") as file:
        try:
            file.write(line + b"\n")
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            os.truncate(path, start)  # half a line on a full disk would join the next one
            raise


def write_trace(trace: Trace, path: Path) -> None:
    """Write a trace, and flush it to the disk; raise an OSError, or a TraceError if the format cannot hold it."""
    try:
        logs.write(trace, path)
    except TraceError as error:
        raise error.__context__ if isinstance(error.__context__, OSError) else error from None
