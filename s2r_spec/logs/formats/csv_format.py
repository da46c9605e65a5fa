"""Comma-separated values: a header ``t, vx [m/s], u[0] [V], u[1] [V]``, and one row per sample.

A unit follows its name in brackets after a space. Components of a vector have a number in brackets without a space,
from 0. Lines before the header that begin with ``#`` are comments, except ``# s2r {"meta": …}`` with the trace's meta.
"""

from __future__ import annotations

import csv
import json
import sys
from array import array
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import NoTimesError, TraceError
from s2r_spec.logs import cells
from s2r_spec.logs import table as parsed
from s2r_spec.logs.formats import csv_bulk, csv_head
from s2r_spec.logs.formats.csv_head import CsvRow, is_number
from s2r_spec.logs.own import rows
from s2r_spec.logs.table import Chooser, Column, Head, Table, quote
from s2r_spec.trace import Trace

T = TypeVar("T")
_NOTES = "# s2r "
LONGEST = 2**22
"""Budget: characters of one line, 4 million."""
csv.field_size_limit(LONGEST)  # a column that is not read may hold a picture as text
_CELLS = 2**18
"""Budget: cells stored as text before they become arrays, 20 MB."""


def load(path: Path, choose: Chooser) -> Table:
    """Read the chosen columns of a file.

    Raises:
        TraceError: the file is not comma-separated text with a header, or a row has another length.
        OSError: the file cannot be read.
    """
    parsed.check_file(path)
    # "utf-8-sig": spreadsheets write a byte-order mark. "replace": a column that is not read may hold any bytes.
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as stream:
        text = Text(lambda: stream.readline(LONGEST))
        needed = sorted(set(text.choose(choose)))
        first = text.first_line
        bulk = None if first is None else csv_bulk.numbers(path, first - 1, len(text.heads), needed)
        columns, lines = _read_rows(text, needed) if bulk is None else ({}, range(first or 0, sys.maxsize))
    columns |= {number: Column(values) for number, values in (bulk or {}).items()}
    place = line_places(text.heads, lines)
    return Table(text.heads, columns, text.meta, place, tuple(text.notes), own=text.own)


class Text:
    """A table that is read row by row: comments, names of columns, their units if these are a row of their own, rows.

    Args:
        readline: returns the next line with its line break, at most :data:`LONGEST` characters; "" at the end.

    Attributes:
        heads: heads of the columns.
        meta: meta from the first line, as in :class:`Trace`.
        own: record of own samples, from the first line.
        first_line: number of the line of the first row, from 1; None if the names are a comment.
        notes: notes on rows left out so far.

    Raises:
        TraceError: there is no header, or the names are in a later line.
    """

    def __init__(self, readline: Callable[[], str]) -> None:
        self.meta: dict[str, Any] = {}
        self.own: dict[str, Any] = {}
        self.notes: list[str] = []
        self._number, self._cut = 0, False  # of the last line; whether it has no line break
        lines = self._lines(readline)
        comment = first = ""
        for first in lines:
            if first.startswith(_NOTES):
                self.meta, self.own = _meta(first, self._number)
            elif first.startswith("#"):
                comment = first
            elif first.strip():
                break
            first = ""
        self._reader = csv.reader(chain([first], lines) if first else lines, strict=True)
        names = self._next()
        if names is None or not names.cells:
            raise TraceError("the file is empty; its first line must name the columns")
        if "\0" in "".join(names.cells):
            raise TraceError(
                "this is not UTF-8 text: it has zero bytes between its letters; save it as UTF-8"
            )
        self._rows: Iterator[CsvRow] = iter(self._next, None)
        self.first_line: int | None = names.line + 1
        above = next(csv.reader([comment.lstrip("# ")]), [])
        if len(above) == len(names.cells) and any(map(is_number, names.cells)):
            # numpy.savetxt and others write the names as a comment
            self._rows, self.first_line = chain([names], self._rows), None
            names = names._replace(cells=above)
        parsed.check_columns(len(names.cells))
        self._names = names
        self.heads = tuple(map(head_of, [names.cells[0] or parsed.INDEX, *names.cells[1:]]))
        self._read_units()

    def _lines(self, readline: Callable[[], str]) -> Iterator[str]:
        while line := readline():
            if self._number == 0:
                line = line.removeprefix("\ufeff")
            self._number += 1
            self._cut = not line.endswith(("\r", "\n"))
            if len(line) >= LONGEST:
                raise TraceError(
                    f"line {self._number} has {LONGEST:,} characters or more; the file is not a table of samples"
                )
            yield line

    def _next(self) -> CsvRow | None:
        before = self._number
        try:
            row = next(self._reader, None)
        except csv.Error as error:
            if self._cut and self._number == before + 1 and before > 0:
                return CsvRow([], self._number, cut=True, torn=True)
            raise TraceError(f"this is not comma-separated text: {error}") from None
        return None if row is None else CsvRow(row, self._number, self._cut)

    def choose(self, choose: Callable[[tuple[Head, ...]], T]) -> T:
        """Return what is chosen by the names.

        Raises:
            TraceError: no column has the times; the message says if the names seem to be in a later line.
        """
        try:
            return choose(self.heads)
        except NoTimesError:
            csv_head.refuse_above(self._names, self._ahead())
            raise

    def _read_units(self) -> None:
        below = next((row for row in self._ahead(1) if not row.torn), None)
        if self._names.width < 2:
            csv_head.refuse_above(self._names, self._ahead())
            csv_head.refuse_separators(self._names, below)
        if below is None or below.cut:
            return
        if csv_head.may_be_sample(below):
            if below.width > len(self.heads):
                csv_head.refuse_above(self._names, self._ahead())
            return
        heads = csv_head.with_units(self.heads, below)
        if heads is None:
            csv_head.refuse_almost_units(self.heads, below)
            csv_head.refuse_above(self._names, self._ahead())
            return
        self.heads = heads
        self.first_line = None if self.first_line is None else below.line + 1
        self.notes.append(f"line {below.line} is read as the units of the columns")
        next(self._rows)

    def _ahead(self, count: int = csv_head.AHEAD) -> list[CsvRow]:
        """Return the next rows with text up to the first that begins as a sample; they stay to be read."""
        rows: list[CsvRow] = []
        for row in self._rows:
            if row.torn or not row.blank:
                rows.append(row)
                if len(rows) == count or row.torn or csv_head.begins_sample(row):
                    break
        self._rows = chain(rows, self._rows)
        return rows

    def rows(self, needed: Sequence[int]) -> Iterator[tuple[int, list[str]]]:
        """Yield (line, cells) of every row that has the needed columns; an incomplete last row becomes a note.

        Raises:
            TraceError: a row before the last has a different length from the header.
        """
        width = len(self.heads)
        named = max((i for i, head in enumerate(self.heads) if head.name), default=-1) + 1
        last = max(needed, default=-1)
        bad: tuple[int, str] | None = None
        for row, line, cut, torn in self._rows:
            if torn:
                bad = line, "ends inside quotes"
                break
            if not row or not any(map(str.strip, row)):
                continue
            if bad is not None:
                raise TraceError(f"line {bad[0]} {bad[1]}")
            count = len(row)
            if count != width:
                while len(row) > width and not row[-1].strip():
                    row.pop()  # commas at the end of a row, after its last value
                if not named <= len(row) <= width:
                    bad = line, f"has {count} values, but there are {width} columns"
                    continue
                row += [""] * (width - len(row))
            if cut and last >= min(count, width) - 1:
                bad = line, "has no end"
                continue
            yield line, row
        if bad is not None:
            fault = "has no line break at its end" if self._cut else "has fewer values than columns"
            if not self._cut and count > width:
                raise TraceError(f"line {bad[0]} {bad[1]}")
            self.notes.append(
                f"the last row, line {bad[0]}, {fault}: it may be incomplete and is left out; complete it to use it"
            )


def _meta(line: str, number: int) -> tuple[dict[str, Any], dict[str, Any]]:
    try:
        record = json.loads(line.removeprefix(_NOTES))
        if not isinstance(record, dict) or "meta" not in record:
            raise ValueError("'meta'")
        return parsed.read_description(record, f"line {number}")[1:]
    except (ValueError, RecursionError) as error:
        raise TraceError(f'line {number}: expected {_NOTES}{{"meta": {{…}}}}: {error}') from None


def head_of(text: str) -> Head:
    """Parse a cell of the header: ``u[0] [V]`` is component 0 of u, in V."""
    name, unit, index = text.strip(), None, None
    at = name.rfind("[")
    if name.endswith("]") and at > 0 and name[at - 1].isspace() and "]" not in name[at:-1]:
        name, unit = name[:at].rstrip(), name[at + 1 : -1]
    at = name.rfind("[")
    digits = name[at + 1 : -1]
    if name.endswith("]") and at > 0 and digits.isascii() and digits.isdigit() and len(digits) < 7:
        name, index = name[:at], int(digits)
    return Head(name, index, unit)


def _read_rows(text: Text, needed: Sequence[int]) -> tuple[dict[int, Column], Sequence[int]]:
    pieces: dict[int, list[NDArray[Any]]] = {number: [] for number in needed}
    waiting: dict[int, list[str]] = {number: [] for number in needed}
    lines = array("q")
    most = max(1, _CELLS // len(needed))
    taken = 0

    def to_arrays() -> None:
        nonlocal taken
        for number, texts in waiting.items():
            piece = cells.parse(texts)
            pieces[number].append(piece)
            taken += piece.size * (parsed.TEXT_SIZE if piece.dtype == object else 1)
            texts.clear()
        parsed.check_size(taken)

    for line, row in text.rows(needed):
        lines.append(line)
        for number, texts in waiting.items():
            texts.append(row[number])
        if len(lines) % most == 0:
            to_arrays()
    to_arrays()
    return {number: _join(parts) for number, parts in pieces.items()}, lines


def line_places(heads: Sequence[Head], lines: Sequence[int]) -> Callable[[int, int], str]:
    """Return (sample number, head number) → place, from the number of each sample's line."""
    return lambda sample, number: f"line {lines[sample]}, column {number + 1} ({heads[number].name})"


def _join(pieces: Sequence[NDArray[Any]]) -> Column:
    if not any(piece.dtype == object for piece in pieces):
        whole = all(piece.dtype == np.int64 for piece in pieces if piece.size)
        values = np.concatenate([piece.astype(np.int64 if whole else np.float64) for piece in pieces])
        return Column(values)
    texts = [piece if piece.dtype == object else cells.words(map(repr, piece.tolist())) for piece in pieces]
    words = np.concatenate(texts)
    return Column(words, cells.is_missing(words))


def write(trace: Trace, path: Path) -> None:
    """Write a trace."""
    times, channels, record = rows(trace)
    header, arrays = ["t [s]"], [times]
    for name, values in channels.items():
        parts = [name] if values.ndim == 1 else [f"{name}[{i}]" for i in range(values.shape[1])]
        for i, part in enumerate(parts):
            unit = trace.units.get(name)
            text = part if unit is None else f"{part} [{unit}]"
            if name == "t" or head_of(text) != Head(name, None if values.ndim == 1 else i, unit) or not name:
                raise TraceError(
                    f"a CSV file cannot hold a channel called {quote(name)} with the unit {unit!r}"
                )
            header.append(text)
            arrays.append(values if values.ndim == 1 else values[:, i])
        if not parts:
            raise TraceError(f"a CSV file cannot hold the channel {quote(name)}, which has no components")
    with path.open("w", newline="", encoding="utf-8") as stream:
        if trace.meta or record:
            notes = {"meta": dict(trace.meta)} | ({"own": record} if record else {})
            stream.write(f"{_NOTES}{json.dumps(notes)}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        # repr is the shortest text that reads back as the same float64
        writer.writerows([repr(float(x)) for x in row] for row in zip(*arrays, strict=True))
