"""Read a table of comma-separated values while a program writes it, with the rules for a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from s2r_spec.base.errors import TraceError
from s2r_spec.logs import cells, interpret
from s2r_spec.logs.formats.csv_format import LONGEST, Text, line_places
from s2r_spec.logs.mapping import ColumnRequest, plan_columns
from s2r_spec.logs.table import Column, Table
from s2r_spec.logs.times import times


@dataclass(frozen=True)
class Rows:
    """A table that is read row by row while it is written.

    Args:
        units: channel → unit, for channels with a unit.
        meta: meta from the first line, as in :class:`s2r_spec.trace.Trace`.
        samples: (time [s], channel → number, or list of numbers for a vector).
        notes: notes on rows left out so far, one sentence each; grows while samples are read.
    """

    units: Mapping[str, str]
    meta: Mapping[str, Any]
    samples: Iterator[tuple[float, dict[str, Any]]]
    notes: list[str]


def follow(readline: Callable[[int], str], request: ColumnRequest) -> Rows:
    """Read the header of a table now, and each row on request.

    ``readline`` returns the next line of a text stream, with at most the given number of characters.

    Raises:
        TraceError: as for a file, also during the reading of rows.
    """
    text = Text(lambda: readline(LONGEST))
    plan = text.choose(lambda heads: plan_columns(heads, request))
    if plan.faults and request.wanted is not None and not text.meta.get("failure"):
        raise TraceError(next(iter(plan.faults.values())))
    needed = sorted(plan.needed)
    text.notes.extend(plan.notes)
    heads = [text.heads[number] for number in plan.times]
    units = {
        channel.name: unit
        for channel in plan.channels
        if (unit := channel.parts[0].unit or text.heads[channel.parts[0].number].unit) is not None
    }

    def samples() -> Iterator[tuple[float, dict[str, Any]]]:
        first: Any = None
        for line, row in text.rows(needed):
            columns = {number: _column(row[number]) for number in needed}
            table = Table(text.heads, columns, text.meta, line_places(text.heads, [line]))
            own, place = [columns[number] for number in plan.times], table.places(plan.times[0])
            stamps = times.read(own, heads, request.time_unit, place, first)
            if first is None:
                text.notes.extend(stamps.notes)
            first = stamps.first
            read = interpret.channels(table, plan, 1)
            if read.faults:
                raise TraceError(next(iter(read.faults.values())))
            yield float(stamps.seconds[0]), {name: one[0].tolist() for name, one in read.samples.items()}

    return Rows(units, text.meta, samples(), text.notes)


def _column(text: str) -> Column:
    values = cells.parse([text])
    return Column(values, cells.is_missing(values) if values.dtype == object else None)
