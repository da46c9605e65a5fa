"""A table of comma-separated values that is read while it is written, by the rules of a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from s2r_spec.errors import TraceError
from s2r_spec.logs import cells, interpret, times
from s2r_spec.logs.csv_format import LONGEST, Text
from s2r_spec.logs.mapping import Request, planned
from s2r_spec.logs.table import Column, Table


@dataclass(frozen=True)
class Rows:
    """A table that is read row by row, as it is written.

    Args:
        units: channel → unit, for those that have one.
        meta: what the first line says, as in :class:`s2r_spec.trace.Trace`.
        samples: (time [s], channel → number, or list of them for a vector).
        notes: what was left out so far, each in a sentence; it grows while samples are read.
    """

    units: Mapping[str, str]
    meta: Mapping[str, Any]
    samples: Iterator[tuple[float, dict[str, Any]]]
    notes: list[str]


def follow(readline: Callable[[int], str], request: Request) -> Rows:
    """Read the header of a table now, and each row when it is asked for.

    Args:
        readline: of a text stream: returns the next line, of so many letters at most.
        request: what to read.

    Raises:
        TraceError: as for a file, also while rows are read.
    """
    text = Text.of(lambda: readline(LONGEST))
    plan = planned(text.heads, request)
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

            def place(_: int, number: int, line: int = line) -> str:
                return f"line {line}, column {number + 1} ({text.heads[number].name})"

            columns = {number: _column(row[number]) for number in needed}
            table = Table(text.heads, columns, text.meta, place)
            stamps = times.read(
                [columns[number] for number in plan.times],
                heads,
                request.time_unit,
                lambda k, place=place: place(k, plan.times[0]),  # type: ignore[misc]
                first,
            )
            if first is None:
                text.notes.extend(stamps.notes)
            first = stamps.first
            made = interpret.channels(table, plan, 1)
            if made.faults:
                raise TraceError(next(iter(made.faults.values())))
            yield float(stamps.seconds[0]), {name: one[0].tolist() for name, one in made.samples.items()}

    return Rows(units, text.meta, samples(), text.notes)


def _column(text: str) -> Column:
    values = cells.parsed([text])
    return Column(values, cells.missing(values) if values.dtype == object else None)
