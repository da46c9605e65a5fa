"""Recorded traces: a format a file of this package, chosen by the ending of the file's name.

A format only parses. What the columns mean — times, units, gaps, truth values,
vectors — is decided after it, alike for all: :mod:`s2r_spec.logs.interpret`.
Nothing is resampled or filled in: what s2r wrote is read back bit for bit.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from s2r_spec.errors import TraceError, TraceNote
from s2r_spec.files import replacing
from s2r_spec.logs import csv_format, npz_format, parquet_format
from s2r_spec.logs.interpret import Loaded, loaded, request
from s2r_spec.logs.mapping import Plan, planned
from s2r_spec.logs.table import Chooser, Head, Table
from s2r_spec.trace import Trace

_PARSERS: dict[str, Callable[[Path, Chooser], Table]] = {
    ".csv": csv_format.load, ".npz": npz_format.load, ".parquet": parquet_format.load,
}  # fmt: skip
_WRITERS: dict[str, Callable[[Trace, Path], None]] = {
    ".csv": csv_format.write, ".npz": npz_format.write, ".parquet": parquet_format.write,
}  # fmt: skip

FORMATS = tuple(sorted(_PARSERS))
"""Endings that can be read and written."""


def read(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    wanted: Mapping[str, int | None] | Sequence[str] | None = None,
    *,
    time_unit: str | None = None,
) -> Trace:
    """Return the trace that a file holds.

    What the reader left out, such as a last row that is cut, is a warning (:class:`TraceNote`).

    Args:
        path: the file.
        columns: name of a channel → what the file calls it, for those that differ; "t" is the times. A component
            is written ``"q[1]"``, on either side. ``"sec+nanosec"`` are times in two columns.
        wanted: channels to read; or name → None for one number a sample, the number of components for a vector.
            Other columns are not looked at. Without it everything is read that can be.
        time_unit: of times that are plain numbers and do not say it: "s", "ms", "us", "ns", "min".

    Raises:
        TraceError: the ending is not one of :data:`FORMATS`, the file cannot be read, or what
            it holds is no trace; the message names the file and, where there is one, the line.
        UsageError: the unit is none of time.
    """
    found = load(path, columns, wanted, time_unit=time_unit)
    unread = [f"the column {name!r} is left out: {why}" for name, why in found.left_out.items()]
    for note in (*found.notes, *unread):
        warnings.warn(f"{path}: {note}", TraceNote, stacklevel=2)
    return found.trace


def load(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    wanted: Mapping[str, int | None] | Sequence[str] | None = None,
    *,
    time_unit: str | None = None,
    gather: bool = False,
) -> Loaded:
    """Return the trace that a file holds, with what its user should know; see :func:`read`.

    Args:
        path: the file.
        columns: see :func:`read`.
        wanted: see :func:`read`.
        time_unit: see :func:`read`.
        gather: where everything is read, make vectors of numbered columns (``q_0``, ``q_1``), too.

    Raises:
        TraceError: see :func:`read`.
        UsageError: see :func:`read`.
    """
    path = Path(path)
    parser = _PARSERS[_ending(path)]
    asked = request(columns, wanted, time_unit, gather)
    plans: list[Plan] = []

    def choose(heads: tuple[Head, ...]) -> set[int]:
        plans.append(planned(heads, asked))
        return plans[-1].needed

    try:
        table = parser(path, choose)
        return loaded(table, plans[-1], asked)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise TraceError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from None
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None


def write(trace: Trace, path: str | Path) -> None:
    """Write a trace; an existing file is replaced whole or not at all.

    Raises:
        TraceError: the ending is not one of :data:`FORMATS`, the format cannot hold a name of
            the trace, or the file cannot be written.
    """
    path = Path(path)
    writer = _WRITERS[_ending(path)]
    try:
        with replacing(path) as beside:
            writer(trace, beside)
    except OSError as error:
        raise TraceError(f"cannot write {path}: {error.strerror or error}") from None
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None


def _ending(path: Path) -> str:
    ending = path.suffix.lower()
    if ending not in _PARSERS:
        raise TraceError(
            f"{path}: the ending {ending!r} is not a trace format; there are {', '.join(FORMATS)}"
        )
    return ending
