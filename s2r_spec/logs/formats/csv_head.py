"""Tell names, units and samples apart in the first rows of comma-separated text.

A sample has a time, so one of its cells is a number, a date or a duration. A row without any is no sample. It states
the units of the columns if every cell with text is a unit, or a mark for none. Lines above the names are refused, not
skipped: they may state the units of the columns, as those of OptiTrack do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import NamedTuple

from s2r_spec.base.errors import TraceError, shortened
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.logs.table import Head, quote
from s2r_spec.logs.times import dates, durations, time_units

AHEAD = 100
"""Budget: rows that are read in search of the line of the names."""
_NONE = frozenset(("", "-", "--", "–", "—", "[-]", "(-)"))
"""Definition: cells in a row of units below a column without one."""
_SEPARATORS = (";", "\t", "|", " ")
"""Definition: marks that other tools write between values, the surest first."""


class CsvRow(NamedTuple):
    """A row of the file: its cells, and the number of its last line, from 1.

    A row is cut if this line has no line break, and torn if it ends inside quotes.
    """

    cells: list[str]
    line: int
    cut: bool = False
    torn: bool = False

    @property
    def blank(self) -> bool:
        """Whether it has no text."""
        return not any(map(str.strip, self.cells))

    @property
    def width(self) -> int:
        """Number of cells up to the last one with text."""
        return max((number for number, cell in enumerate(self.cells, 1) if cell.strip()), default=0)


def is_number(text: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def is_time(text: str) -> bool:
    """Return whether a cell may be the time of a sample: a number, a date or a duration."""
    return is_number(text) or dates.is_date(text) or durations.is_one(text)


def may_be_sample(row: CsvRow) -> bool:
    """Return whether a row may be a sample, as far as its cells tell."""
    return any(is_time(cell.strip()) for cell in row.cells)


def with_units(heads: Sequence[Head], row: CsvRow) -> tuple[Head, ...] | None:
    """Return the heads with the units of a row; None if a cell of the row is no unit.

    Raises:
        TraceError: the row contradicts a unit in the names.
    """
    units = [_unit(cell) for cell in row.cells]
    if row.width > len(heads) or not any(units) or None in units:
        return None
    named = []
    for head, unit in zip_longest(heads, units[: len(heads)]):
        split = time_units.split_brackets(head.name)
        written = head.unit if head.unit is not None or split is None else split[1]
        if unit and written is not None and written != unit and _unit(written):
            raise TraceError(
                f"line {row.line} states {quote(unit)} for {quote(head.text)}, whose name states {quote(written)}; "
                f"keep one of the two units"
            )
        named.append(replace(head, unit=unit or head.unit))
    return tuple(named)


def _unit(cell: str) -> str | None:
    """Return the unit of a cell, "" for a mark of none, or None if it is neither."""
    text = cell.strip()
    if text in _NONE:
        return ""
    if text[:1] + text[-1:] in ("[]", "()"):
        text = text[1:-1].strip()
    if time_units.size(text) is not None:
        return text
    try:
        parse_unit(text)
    except UnknownUnitError:
        return None
    return text


def refuse_almost_units(heads: Sequence[Head], row: CsvRow) -> None:
    """Refuse a row below the names that is no sample, and most of whose texts are units.

    Raises:
        TraceError: it is such a row; the message says how to state the units.
    """
    units = [_unit(cell) for cell in row.cells]
    known = next((number for number, unit in enumerate(units[: len(heads)]) if unit), None)
    if known is not None and None in units and units.count(None) < len(list(filter(None, units))):
        other = row.cells[units.index(None)].strip()
        raise TraceError(
            f"line {row.line} looks like a row of units, but {quote(other)} is no unit. Delete the line, and "
            f"write the units into the names, such as {shortened(heads[known].text)} [{units[known]}]"
        )


def begins_sample(row: CsvRow) -> bool:
    """Return whether a row begins with a number or a time, and has another cell."""
    first = row.cells[0].strip() if row.width > 1 else ""
    return is_time(first)


def refuse_above(names: CsvRow, rows: Sequence[CsvRow]) -> None:
    """Refuse a file whose names are missing, or seem to stand below other lines.

    The line of the names is the one above the first row that begins as a sample, or above its row of units. It has no
    number itself, and as many cells as the row. ``rows`` are those with text below the names, up to the first that
    begins as a sample.

    Raises:
        TraceError: the names are in a later line, or there are none.
    """
    if all(is_time(cell.strip()) for cell in names.cells):
        raise TraceError(
            f"line {names.line} holds values, not the names of columns; write a line of names above it, such as t,v"
        )
    *lines, first = (names, *rows)
    texts = {_unit(cell) for cell in lines[-1].cells} if lines else set()
    above = lines[:-1] if any(texts) and None not in texts else lines
    if (
        len(above) > 1
        and begins_sample(first)
        and not may_be_sample(above[-1])
        and above[-1].width >= first.width
    ):
        raise TraceError(
            f"line {names.line} does not name the columns; the names seem to be in line {above[-1].line}. Delete the "
            f"lines above it, but mind the units that they state; name each column differently"
        )


def refuse_separators(names: CsvRow, below: CsvRow | None) -> None:
    """Refuse a file whose values are separated by something else than commas.

    Raises:
        TraceError: the names are one cell, and have another mark in it that the row below them has, too.
    """
    text = "" if below is None else ",".join(below.cells)
    for mark in _SEPARATORS:
        if mark in names.cells[0] and (below is None or mark in text):
            raise TraceError(
                f"line {names.line} separates names by {mark!r}. Separate names and values by commas, and write "
                f"decimal points: 0.5, not 0,5"
            )
