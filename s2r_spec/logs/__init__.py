"""Recorded traces: one reader and writer a format, chosen by the ending of the file's name.

Nothing is resampled, rounded or filled in: what is written is read back bit
for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from s2r_spec.errors import TraceError
from s2r_spec.logs import csv_format, npz_format, parquet_format
from s2r_spec.logs.times import TIME
from s2r_spec.trace import Trace

_READERS: dict[str, Callable[[Path, str], Trace]] = {
    ".csv": csv_format.read, ".npz": npz_format.read, ".parquet": parquet_format.read,
}  # fmt: skip
_WRITERS: dict[str, Callable[[Trace, Path], None]] = {
    ".csv": csv_format.write, ".npz": npz_format.write, ".parquet": parquet_format.write,
}  # fmt: skip

FORMATS = tuple(sorted(_READERS))
"""Endings that can be read and written."""


def read(path: str | Path, columns: Mapping[str, str] | None = None) -> Trace:
    """Return the trace that a file holds.

    Args:
        path: the file.
        columns: name of a channel → what the file calls it, for those that differ; "t" is the times.

    Raises:
        TraceError: the ending is not one of :data:`FORMATS`, the file cannot be read, or what
            it holds is no trace; the message names the file and, where there is one, the line.
    """
    path = Path(path)
    reader = _READERS[_ending(path)]
    others = dict(columns or {})
    try:
        return _renamed(reader(path, others.pop(TIME, TIME)), others)
    except OSError as error:
        raise TraceError(f"cannot read {path}: {error.strerror or error}") from None
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None


def _renamed(trace: Trace, columns: Mapping[str, str]) -> Trace:
    """Return the trace with channels called as wanted; those that are not mentioned keep their names."""
    taken = set(columns.values())
    names = {name: name for name in trace.channels if name not in taken} | dict(columns)
    channels = {name: trace[column] for name, column in names.items()}
    units = {name: trace.units[column] for name, column in names.items() if column in trace.units}
    return Trace(trace.times, channels, units, trace.meta)


def write(trace: Trace, path: str | Path) -> None:
    """Write a trace; an existing file is replaced.

    Raises:
        TraceError: the ending is not one of :data:`FORMATS`, the format cannot hold a name of
            the trace, or the file cannot be written.
    """
    path = Path(path)
    writer = _WRITERS[_ending(path)]
    try:
        writer(trace, path)
    except OSError as error:
        raise TraceError(f"cannot write {path}: {error.strerror or error}") from None
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None


def _ending(path: Path) -> str:
    ending = path.suffix.lower()
    if ending not in _READERS:
        raise TraceError(
            f"{path}: the ending {ending!r} is not a trace format; there are {', '.join(FORMATS)}"
        )
    return ending
