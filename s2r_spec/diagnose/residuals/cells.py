"""Cells over which a quantity is averaged: windows of time, and equal parts of what a recorded channel did.

Cells along a channel lie where a rollout of the simulator at the same test has these values at that time. Cells by what
each rollout did itself would differ wherever the channel that bounds them does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.simulator.bench import Bench, Test
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.space import Key, key_of
from s2r_spec.trace import Trace

CELLS = 32
"""Definition: shortest windows of time in a rollout, a power of two; cells along a channel are half as many."""
GRID = 1000
"""Definition: times of a rollout at which its cell along a channel is known."""


class Cell(NamedTuple):
    """Where a quantity is averaged: between two values of a channel [its unit], or of time [s] for the channel "".

    An end that is nowhere is infinite.
    """

    along: str
    low: float
    high: float


class CellColumn(NamedTuple):
    """The cells of one column of a quantity: CELLS windows of time first, and their slice of all cells."""

    quantity: str
    number: int
    cells: list[Cell]
    part: slice

    @property
    def residual(self) -> bool:
        """Whether the quantity is a residual of the equations of motion, not a recorded channel."""
        return self.quantity.startswith(RESIDUAL)


@dataclass(frozen=True)
class Cells:
    """All cells, and where they are at every test.

    Attributes:
        duration, widths: of a rollout [s], and quantity → columns.
        edges: (channel, column) → rising values between the cells along it.
        at: test → (len(edges), GRID) the cell along each of them at each time.
    """

    duration: float
    widths: Mapping[str, int]
    edges: Mapping[tuple[str, int], FloatArray]
    at: Mapping[Key, NDArray[np.uint8]]

    @classmethod
    def of(cls, duration: float, widths: Mapping[str, int], paths: Mapping[Key, FloatArray]) -> Cells:
        """Choose the edges along recorded channels, with as many times of the (GRID, columns) paths between two."""
        every = np.concatenate(list(paths.values()))
        edges, numbers = {}, []
        for number, (name, column) in enumerate(_columns(widths)):
            values = every[np.isfinite(every[:, number]), number]
            if values.size and not name.startswith(RESIDUAL):
                parts = np.quantile(values, np.linspace(0.0, 1.0, CELLS // 2 + 1)[1:-1])
                edges[name, column] = np.unique(parts)
                numbers.append(number)
        pairs = [*zip(numbers, edges.values(), strict=True)]
        at = {}
        for test, rows in paths.items():
            along = [np.searchsorted(each, rows[:, number]) for number, each in pairs]
            at[test] = np.array(along, dtype=np.uint8).reshape(-1, GRID)
        return cls(duration, widths, edges, at)

    def _axes(self, name: str, column: int) -> dict[tuple[str, int], FloatArray]:
        ends = {("", 0): np.linspace(0.0, self.duration, CELLS + 1)}
        for key, edges in self.edges.items():
            if key[1] == column and self.widths[key[0]] == self.widths[name]:
                ends[key] = np.concatenate([[-np.inf], edges, [np.inf]])
        return ends

    def columns(self) -> list[CellColumn]:
        """Return the columns of all quantities, with their cells in the order of :meth:`means`."""
        columns: list[CellColumn] = []
        for name, number in _columns(self.widths):
            ends = self._axes(name, number).items()
            cells = [Cell(along, *two) for (along, _), each in ends for two in pairwise(each.tolist())]
            begin = columns[-1].part.stop if columns else 0
            columns.append(CellColumn(name, number, cells, slice(begin, begin + len(cells))))
        return columns

    def means(self, trace: Trace, test: Test) -> FloatArray:
        """Return (cells,) means of a rollout; NaN where it has no sample, or lacks the quantity."""
        part = (trace.times - trace.times[0]) / self.duration
        rows = self.at[key_of(test)][:, np.clip((part * GRID + 1e-6).astype(int), 0, GRID - 1)]
        places = dict(zip(self.edges, rows.astype(np.intp), strict=True))
        places["", 0] = np.clip((part * CELLS).astype(int), 0, CELLS - 1)
        missing = np.full(len(trace), np.nan)
        means = []
        for name, column in _columns(self.widths):
            values = trace[name].reshape(len(trace), -1)[:, column] if name in trace.channels else missing
            ends = self._axes(name, column).items()
            means += [cell_means(values, places[key], len(each) - 1) for key, each in ends]
        return np.concatenate(means)


def _columns(widths: Mapping[str, int]) -> list[tuple[str, int]]:
    return [(name, column) for name, width in widths.items() for column in range(width)]


def path(widths: Mapping[str, int], bench: Bench, trace: Trace, test: Test) -> FloatArray:
    """Return (GRID, columns) the quantities of a rollout at the times of the grid; the last ones after its end."""
    complete = bench.seen(trace, test)
    grid = np.arange(GRID) / GRID * bench.backend.duration
    sample = np.clip(np.searchsorted(complete.times - complete.times[0], grid - 1e-9), 0, len(complete) - 1)
    return np.column_stack([complete[name].reshape(len(complete), -1)[sample] for name in widths])


def cell_means(values: FloatArray, place: NDArray[np.intp], count: int) -> FloatArray:
    """Return (count,) means of (n,) values by their place; NaN where there is none."""
    there = np.isfinite(values)
    if not there.all():
        place, values = place[there], values[there]
    counts, sums = np.bincount(place, minlength=count), np.bincount(place, values, minlength=count)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def widths_of(traces: Sequence[Trace]) -> dict[str, int]:
    """Return channel → columns, of the channels with as many columns in all traces."""
    each = [
        {name: 1 if x.ndim == 1 else x.shape[1] for name, x in trace.channels.items()} for trace in traces
    ]
    return {name: width for name, width in each[0].items() if all(one.get(name) == width for one in each)}


def part_names(trace: Trace, channel: str, width: int) -> tuple[str, ...]:
    """Return the part of the machine of each column of a residual; () if the backend names none."""
    declared = trace.meta.get("parts", {})
    names = tuple(map(str, declared.get(channel, ()))) if isinstance(declared, Mapping) else ()
    return names if len(names) == width else ()
