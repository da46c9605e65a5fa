"""Comma-separated values: a header ``t, vx [m/s], u[0] [V], u[1] [V]``, a row a sample.

Times are in seconds. A unit follows its name in brackets, after a space; the
components of a vector are numbered from 0, without one. A first line
``# s2r {"meta": …}`` holds what has no column.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.errors import TraceError, one_of
from s2r_spec.logs.times import TIME as _TIME
from s2r_spec.logs.times import no_times
from s2r_spec.trace import Trace

_NOTES = "# s2r "
_HEADER = re.compile(r"(?P<name>.+?)(?:\[(?P<index>\d+)\])?(?:\s+\[(?P<unit>[^\[\]]*)\])?")


@dataclass(frozen=True)
class _Column:
    name: str
    index: int | None
    unit: str | None


def read(path: Path, time: str = _TIME) -> Trace:
    """Read a file of :func:`write`, or any other of numbers, one column of which holds the times."""
    try:
        # "utf-8-sig": spreadsheets begin their files with a byte-order mark
        with path.open(newline="", encoding="utf-8-sig") as stream:
            first = stream.readline()
            meta = _meta(first)
            if meta is None:
                stream.seek(0)
            return _table(csv.reader(stream, strict=True), meta or {}, 0 if meta is None else 1, time)
    except UnicodeDecodeError as error:
        raise TraceError(f"this is not UTF-8 text: {error.reason} at byte {error.start}") from None
    except csv.Error as error:
        raise TraceError(f"this is not comma-separated text: {error}") from None


def _meta(line: str) -> dict[str, Any] | None:
    if not line.startswith(_NOTES):
        return None
    try:
        notes = json.loads(line.removeprefix(_NOTES))
        return dict(notes["meta"])
    except (json.JSONDecodeError, KeyError, TypeError, ValueError) as error:
        raise TraceError(f'line 1: expected {_NOTES}{{"meta": {{…}}}}: {error}') from None


def _table(rows: Iterator[list[str]], meta: dict[str, Any], skipped: int, called: str) -> Trace:
    reader: Any = rows  # csv.reader counts lines in .line_num, which Iterator does not know
    header = next(rows, None)
    if not header:
        raise TraceError("the file is empty; its first line names the columns")
    columns = _columns(header)
    time, (places, units) = _time(columns, called), _places(columns, called)
    values: list[list[float]] = []
    for row in rows:
        if row:
            values.append(_numbers(row, columns, reader.line_num + skipped))
    table = np.array(values, dtype=np.float64).reshape(len(values), len(columns))
    channels = {name: table[:, place] for name, place in places.items()}
    return Trace(table[:, time], channels, units, meta)


@dataclass(frozen=True)
class Rows:
    """A table that is read row by row, as it is written.

    Args:
        units: channel → unit, for those that have one.
        meta: what the first line says, as in :class:`Trace`.
        samples: (time [s], channel → number, or list of them for a vector).
    """

    units: Mapping[str, str]
    meta: Mapping[str, Any]
    samples: Iterator[tuple[float, dict[str, Any]]]


def follow(lines: Iterable[str], called: str = _TIME) -> Rows:
    """Read the header of a table now, and each row when it is asked for.

    Raises:
        TraceError: as for a file, also while rows are read.
    """
    source = iter(lines)
    first = next(source, "").removeprefix("\ufeff")
    meta = _meta(first)
    skipped = 0 if meta is None else 1
    rows = csv.reader(source if skipped else chain([first], source), strict=True)
    header = next(rows, None)
    if not header:
        raise TraceError("the file is empty; its first line names the columns")
    columns = _columns(header)
    time, (places, units) = _time(columns, called), _places(columns, called)

    def samples() -> Iterator[tuple[float, dict[str, Any]]]:
        try:
            for row in filter(None, rows):
                numbers = _numbers(row, columns, rows.line_num + skipped)
                yield (
                    numbers[time],
                    {
                        name: numbers[place] if isinstance(place, int) else [numbers[i] for i in place]
                        for name, place in places.items()
                    },
                )
        except csv.Error as error:
            raise TraceError(f"this is not comma-separated text: {error}") from None

    return Rows(units, meta or {}, samples())


def _columns(header: Sequence[str]) -> list[_Column]:
    if len(header) == 1 and (mark := next((mark for mark in ";\t" if mark in header[0]), None)):
        raise TraceError(f"values are separated by commas here, not by {mark!r}, and numbers have a point")
    return [_column(text, number) for number, text in enumerate(header, 1)]


def _time(columns: Sequence[_Column], called: str) -> int:
    """Return the number of the column that holds the times."""
    times = [number for number, column in enumerate(columns) if (column.name, column.index) == (called, None)]
    if not times:
        there = one_of(dict.fromkeys(column.name for column in columns))
        raise TraceError(no_times("column", called, there))
    if len(times) != 1:
        raise TraceError(f"{len(times)} columns are called {called!r}; one holds the times in seconds")
    if columns[times[0]].unit not in (None, "s"):
        raise TraceError(f"the times are in {columns[times[0]].unit!r}; they must be in seconds")
    return times[0]


def _column(text: str, number: int) -> _Column:
    match = _HEADER.fullmatch(text.strip())
    if match is None:
        raise TraceError(f"line 1, column {number}: {text!r} is not a name with a unit, such as 'vx [m/s]'")
    index = None if match["index"] is None else int(match["index"])
    return _Column(match["name"], index, match["unit"])


def _numbers(row: Sequence[str], columns: Sequence[_Column], line: int) -> list[float]:
    if len(row) != len(columns):
        raise TraceError(f"line {line} has {len(row)} values, but there are {len(columns)} columns")
    try:
        if "_" in "".join(row):  # Python reads 1_000, no one else does
            raise ValueError
        return [float(text) for text in row]
    except ValueError:
        return [
            _number(text, column, line, number)
            for number, (text, column) in enumerate(zip(row, columns, strict=True), 1)
        ]


def _number(text: str, column: _Column, line: int, number: int) -> float:
    try:
        if "_" in text:
            raise ValueError
        return float(text)
    except ValueError:
        what = "is empty" if not text.strip() else f"is {text!r}, not a number"
        raise TraceError(f"line {line}, column {number} ({column.name}) {what}") from None


def _places(columns: Sequence[_Column], time: str) -> tuple[dict[str, int | list[int]], dict[str, str]]:
    """Return the column of each channel, or those of its components in order; and the units."""
    found: dict[str, dict[int | None, int]] = {}
    units: dict[str, str] = {}
    for number, column in enumerate(columns):
        if (column.name, column.index) == (time, None):
            continue
        parts = found.setdefault(column.name, {})
        if column.index in parts:
            raise TraceError(f"line 1, column {number + 1}: a second column is called {column.name!r}")
        if parts and units.get(column.name) != column.unit:
            raise TraceError(
                f"line 1, column {number + 1}: the components of {column.name!r} have different units"
            )
        parts[column.index] = number
        if column.unit is not None:
            units[column.name] = column.unit
    places: dict[str, int | list[int]] = {}
    for name, parts in found.items():
        if None in parts and len(parts) == 1:
            places[name] = parts[None]
        elif set(parts) == set(range(len(parts))):
            places[name] = [parts[index] for index in range(len(parts))]
        else:
            raise TraceError(
                f"the components of {name!r} are not numbered {name}[0] to {name}[{len(parts) - 1}]"
            )
    return places, units


def write(trace: Trace, path: Path) -> None:
    """Write a trace."""
    header, arrays = [f"{_TIME} [s]"], [trace.times]
    for name, values in trace.channels.items():
        parts = [name] if values.ndim == 1 else [f"{name}[{i}]" for i in range(values.shape[1])]
        for i, part in enumerate(parts):
            unit = trace.units.get(name)
            text = part if unit is None else f"{part} [{unit}]"
            expected = _Column(name, None if values.ndim == 1 else i, unit)
            if name == _TIME or not parts or _HEADER.fullmatch(text) is None or _column(text, 0) != expected:
                raise TraceError(f"a CSV file cannot hold a channel called {name!r} with the unit {unit!r}")
            header.append(text)
            arrays.append(values if values.ndim == 1 else values[:, i])
    with path.open("w", newline="", encoding="utf-8") as stream:
        if trace.meta:
            stream.write(f"{_NOTES}{json.dumps({'meta': dict(trace.meta)})}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        # the shortest text of a float64 that reads back as the same number
        writer.writerows([repr(float(x)) for x in row] for row in zip(*arrays, strict=True))
