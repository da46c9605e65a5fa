"""Tables of several episodes, one after the other, as LeRobot writes them: a column numbers the episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from s2r_spec.base.errors import TraceError
from s2r_spec.logs.table import Table

EPISODE = "episode_index"
"""Definition: the column that numbers the episodes of a LeRobot data set (version 3.0 of its format)."""


def split_episodes(table: Table, number: int) -> list[Table]:
    """Return a table for each episode; ``number`` is that of the column which numbers them.

    Raises:
        TraceError: the column is not readable, or the rows of an episode are not together.
    """
    column = table.columns[number]
    if column.fault:
        raise TraceError(f"the column {EPISODE!r} {column.fault}")
    values = column.values
    begins = [0, *(np.flatnonzero(values[1:] != values[:-1]) + 1).tolist()]
    numbers = values[begins].tolist() if len(values) else []
    repeated = next((one for place, one in enumerate(numbers) if one in numbers[:place]), None)
    if repeated is not None:
        raise TraceError(f"the rows of episode {repeated} are not together; sort the table by {EPISODE!r}")
    return _cut_table(table, begins, len(values))


def runs(table: Table, times: Sequence[int]) -> list[Table]:
    """Return a table for each run of a clock: its plain numbers of time step back where it began anew."""
    column = table.columns[times[0]]
    if len(times) != 1 or column.values.dtype.kind not in "iufmM" or column.values.ndim != 1:
        return [table]
    back = np.flatnonzero(column.values[1:] < column.values[:-1]) + 1
    return _cut_table(table, [0, *back.tolist()], len(column.values)) if back.size else [table]


def _cut_table(table: Table, begins: list[int], count: int) -> list[Table]:
    return [_rows(table, first, end) for first, end in zip(begins, [*begins[1:], count], strict=True)]


def _rows(table: Table, first: int, end: int) -> Table:
    columns = {
        number: column if column.fault else column.only(slice(first, end))
        for number, column in table.columns.items()
    }
    return replace(table, columns=columns, place=lambda sample, number: table.place(first + sample, number))
