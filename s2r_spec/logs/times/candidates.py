"""Ask which of several columns has the times: each candidate with its first time and its period."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from s2r_spec.base.errors import NoTimesError, TraceError
from s2r_spec.logs.options import TIME, map_argument
from s2r_spec.logs.table import Column, Head, Table, quote
from s2r_spec.logs.times import time_units, times

Readable = tuple[Sequence[Column], Sequence[Head]]
"""One or two columns of times, with their heads."""


def question(candidates: Mapping[str, Readable], unit: str | None) -> NoTimesError:
    """Return the error that asks which of two or more candidates, by their names in ``--map t=``, has the times.

    ``unit`` is that of plain numbers, if the user states one.
    """
    ranges = {name: text for name, one in candidates.items() if (text := _describe(*one, unit)) is not None}
    names = tuple(ranges) or tuple(candidates)
    if len(ranges) < 2:
        return NoTimesError(
            f"there is no column {TIME!r} with the times: add --map {map_argument(names[0])}",
            names[0],
        )
    shown = ", or ".join(f"{quote(name)} ({text})" for name, text in ranges.items())
    return NoTimesError(
        f"the times may be {shown}. Choose one, as in --map {map_argument(names[0])}", names[0], names
    )


def of_table(table: Table, columns: Mapping[str, Sequence[int]], unit: str | None) -> NoTimesError:
    """Return :func:`question` for columns of a table, by their numbers."""
    candidates = {
        name: ([table.columns[number] for number in numbers], [table.heads[number] for number in numbers])
        for name, numbers in columns.items()
    }
    return question(candidates, unit)


def _describe(columns: Sequence[Column], heads: Sequence[Head], unit: str | None) -> str | None:
    """Return the first time and the period of a candidate; None if its values are no times."""
    times_read = _read(columns, heads, unit, lambda sample: f"sample {sample}")
    if times_read is None or not times_read.seconds.size:
        return None
    begins = times_read.begins or f"{times_read.seconds[0]:.9g} s"
    if times_read.seconds.size < 2:
        return f"at {begins}"
    return f"from {begins}, every {np.median(np.diff(times_read.seconds)):.4g} s"


def _read(
    columns: Sequence[Column], heads: Sequence[Head], unit: str | None, place: Callable[[int], str]
) -> times.Times | None:
    """Return the times of a candidate, with the likely unit where numbers need one; None if they are no times."""
    first = columns[0].values.flat[0] if columns[0].values.size else 0.0
    plain = isinstance(first, int | float | np.integer | np.floating)
    likely = time_units.looks_like(float(first)) if plain else None
    for one in dict.fromkeys((unit, None, likely)):
        try:
            return times.read(columns, heads, one, place)
        except TraceError:
            continue
    return None
