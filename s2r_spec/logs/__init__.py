"""Recorded traces. Each file format has one module, and the ending of a file's name selects it.

A format module only parses. :mod:`s2r_spec.logs.interpret` gives the columns their meaning (times, units, gaps, truth
values, vectors), in the same way for all formats. Nothing is resampled or filled in, and a trace that s2r wrote is read
back bit for bit.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from s2r_spec.base.errors import NoTimesError, TraceError, TraceNote
from s2r_spec.base.files import replacing
from s2r_spec.logs import split
from s2r_spec.logs.interpret import Loaded, build_trace, request
from s2r_spec.logs.mapping import ColumnPlan, ColumnRequest, plan_columns
from s2r_spec.logs.options import TIME, TimeOptions, unit_of_option
from s2r_spec.logs.table import Chooser, Head, Table
from s2r_spec.logs.topics import formats as topic_formats
from s2r_spec.logs.topics.join import Joining
from s2r_spec.trace import Trace

FORMATS = (".csv", ".npz", ".parquet")
"""Endings that can be read and written; the module of a format is loaded for its first file."""
READABLE = tuple(sorted({*FORMATS, *topic_formats.FORMATS}))
"""Endings that can be read."""


def read(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    wanted: Mapping[str, int | None] | Sequence[str] | None = None,
    *,
    time_unit: str | None = None,
) -> Trace:
    """Read a trace from a file.

    The reader warns (:class:`TraceNote`) of anything that it leaves out, such as an incomplete last row.

    Args:
        path: the file.
        columns: channel → name of its column, if they differ; "t" stands for the times. ``"q[1]"`` is a component, on
            either side. ``"sec+nanosec"`` are times in two columns.
        wanted: channels to read; or channel → None for one number per sample, else the number of components of a
            vector. Other columns are ignored. Without it, all readable columns are read.
        time_unit: unit of times that are plain numbers without a unit: "s", "ms", "us", "ns", "min".

    Raises:
        TraceError: the ending is not one of :data:`READABLE`, the file cannot be read, or it is not a trace. The
            message names the file and, if possible, the line.
        UsageError: the unit is not a unit of time.
    """
    loaded = load(path, columns, wanted, time_unit=time_unit)
    left_out = [f"the column {name!r} is left out: {reason}" for name, reason in loaded.left_out.items()]
    for note in (*loaded.notes, *left_out):
        warnings.warn(f"{path}: {note}", TraceNote, stacklevel=2)
    return loaded.trace


def load(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    wanted: Mapping[str, int | None] | Sequence[str] | None = None,
    *,
    time_unit: str | None = None,
    gather: bool = False,
    joining: Joining | None = None,
) -> Loaded:
    """Read a trace from a file, with notes for the user; for arguments and errors see also :func:`read`.

    Args:
        path: the file.
        columns: channel → name of its column.
        wanted: channels to read.
        time_unit: unit of times that are plain numbers.
        gather: if all columns are read, whether to make vectors of numbered columns (``q_0``, ``q_1``), and to leave
            out fields of topics that are not mapped and whose names no spec can have.
        joining: how topics come to common stamps; None for the defaults of a log of topics, and for a table whose
            rows have all channels.

    Raises:
        TraceError: also if the file has several episodes.
    """
    episodes = load_episodes(path, Reading(columns or {}, wanted, time_unit, gather, joining))
    if len(episodes) > 1:
        raise TraceError(
            f"{path}: the file has {len(episodes)} episodes, numbered by {split.EPISODE!r}, and a trace is one; "
            f"save each in its own file, or evaluate all by `s2r monitor`"
        )
    return replace(episodes[0], trace=episodes[0].trace.known())


@dataclass(frozen=True)
class Reading:
    """What is read of a file, as for :func:`load`.

    Args:
        longest: channel → how long a value is valid, as the user states it [s].
        runs: whether a table has a trace for each run of its clock, whose times step back where it began anew.
    """

    columns: Mapping[str, str]
    wanted: Mapping[str, int | None] | Sequence[str] | None = None
    time_unit: str | None = None
    gather: bool = False
    joining: Joining | None = None
    longest: Mapping[str, float] = field(default_factory=dict)
    runs: bool = False


def load_episodes(path: str | Path, reading: Reading) -> list[Loaded]:
    """Read the traces of a file: one for each episode of a table that numbers its episodes, else one.

    For errors see :func:`load`.
    """
    path, names, joining = Path(path), dict(reading.columns), reading.joining
    arrays = path.suffix.lower() in topic_formats.ARRAYS
    unit = unit_of_option(reading.time_unit)
    open_log = topic_formats.opener(path, TimeOptions(unit, names.pop(TIME, None)) if arrays else None)
    topics = open_log is not None
    if open_log is None:
        parser = _table_format(_ending(path, READABLE)).load
    else:
        from s2r_spec.logs.topics import table as topic_table

        parser = partial(topic_table.load, open_log, joining=_with_clock(joining or Joining(), names))
    # arrays have the times and their unit already
    requested = request(
        names, reading.wanted, None if arrays else unit, reading.gather, reading.gather and topics
    )
    plans: list[ColumnPlan] = []
    episode: list[int] = []

    def choose(heads: tuple[Head, ...]) -> set[int]:
        plans.append(plan_columns(heads, requested))
        named = (number for number, head in enumerate(heads) if head.text == split.EPISODE and not topics)
        episode.extend(islice(named, 1))
        return plans[-1].needed | {*episode}

    try:
        table = parser(path, choose)
        parts = split.split_episodes(table, episode[0]) if episode else [table]
        if reading.runs:
            parts = [run for part in parts for run in split.runs(part, plans[-1].times)]
        if joining is None or topics:
            return [build_trace(part, plans[-1], requested, reading.longest) for part in parts]
        from s2r_spec.logs.topics import sparse

        clocked = _with_clock(joining, {column: name for name, column in names.items()})
        return [sparse.join_rows(part, plans[-1], requested, clocked, reading.longest) for part in parts]
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise TraceError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from None
    except NoTimesError as error:
        question = error if topics else _question(path, parser, error, requested.time_unit)
        raise NoTimesError(f"{path}: {question}", question.likely, question.candidates) from None
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None


def _question(
    path: Path, parser: Callable[[Path, Chooser], Table], error: NoTimesError, unit: str | None
) -> NoTimesError:
    """Return the error of a table without times; if several columns may have them, with what each of them holds."""
    from s2r_spec.logs.times import candidates

    columns: dict[str, tuple[int, ...]] = {}

    def choose(heads: tuple[Head, ...]) -> set[int]:
        for name in error.candidates:
            columns[name] = plan_columns(heads, ColumnRequest({TIME: name}, {})).times
        return {number for numbers in columns.values() for number in numbers}

    try:
        return candidates.of_table(parser(path, choose), columns, unit) if error.candidates else error
    except TraceError:
        return error


def write(trace: Trace, path: str | Path) -> None:
    """Write a trace; an existing file is replaced whole or not at all.

    Raises:
        TraceError: the ending is not one of :data:`FORMATS`, the format cannot hold a name in the trace, or the file
            cannot be written.
    """
    path = Path(path)
    writer = _table_format(_ending(path, FORMATS)).write
    try:
        with replacing(path) as temporary:
            writer(trace, temporary)
    except OSError as error:
        raise TraceError(f"cannot write {path}: {error.strerror or error}") from None
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None


def _table_format(ending: str) -> Any:
    return import_module(f"{__name__}.formats.{ending[1:]}_format")


def _with_clock(joining: Joining, names: Mapping[str, str]) -> Joining:
    """Return a joining whose clock has the name that the file, or the trace, has for it."""
    return replace(joining, clock=None if joining.clock is None else names.get(joining.clock, joining.clock))


def _ending(path: Path, allowed: Sequence[str]) -> str:
    ending = path.suffix.lower()
    if ending not in allowed and path.is_dir():
        raise TraceError(topic_formats.why_not_a_bag(path))
    if ending not in allowed:
        raise TraceError(
            f"{path}: the ending {ending!r} is not a trace format; use one of {', '.join(allowed)}"
        )
    return ending
