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

from s2r_spec.diagnose.simulate import Bench, Test
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.space import Key, key_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

CELLS = 32
"""Definition: shortest windows of time in a rollout, a power of two; cells along a channel are half as many. Doubled,
places are twice as fine."""
GRID = 1000
"""Definition: times of a rollout at which its cell along a channel is known. Doubled, cells have sharper ends."""


class Cell(NamedTuple):
    """Where a quantity is averaged: between two values of a channel [its unit], or of time [s] for the channel "".

    An end that is nowhere is infinite.
    """

    along: str
    low: float
    high: float


class Column(NamedTuple):
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
        duration: of a rollout [s].
        widths: quantity → columns.
        edges: (channel, column) → rising values between the cells along it.
        at: test → (len(edges), GRID) the cell along each of them at each time.
    """

    duration: float
    widths: Mapping[str, int]
    edges: Mapping[tuple[str, int], FloatArray]
    at: Mapping[Key, NDArray[np.uint8]]

    @classmethod
    def of(cls, duration: float, widths: Mapping[str, int], paths: Mapping[Key, FloatArray]) -> Cells:
        """Choose the edges along recorded channels, with as many times of all paths between each two.

        Args:
            duration: of a rollout [s].
            widths: quantity → columns.
            paths: test → (GRID, columns) of :func:`path`.
        """
        edges, numbers = {}, []
        for number, (name, column) in enumerate(_columns(widths)):
            values = np.concatenate([rows[:, number] for rows in paths.values()])
            values = values[np.isfinite(values)]
            if values.size and not name.startswith(RESIDUAL):
                parts = np.quantile(values, np.linspace(0.0, 1.0, CELLS // 2 + 1)[1:-1])
                edges[name, column] = np.unique(parts)
                numbers.append(number)
        at = {}
        for test, rows in paths.items():
            along = [
                np.searchsorted(each, rows[:, n]) for n, each in zip(numbers, edges.values(), strict=True)
            ]
            at[test] = np.array(along, dtype=np.uint8).reshape(-1, GRID)
        return cls(duration, widths, edges, at)

    def _beside(self, name: str, column: int) -> list[tuple[str, int]]:
        """Return the columns of channels along which a column has cells: this one of as many."""
        return [key for key in self.edges if key[1] == column and self.widths[key[0]] == self.widths[name]]

    def columns(self) -> list[Column]:
        """Return the columns of all quantities, with their cells in the order of :meth:`means`."""
        found: list[Column] = []
        for name, number in _columns(self.widths):
            ends = [("", np.linspace(0.0, self.duration, CELLS + 1))]
            for key in self._beside(name, number):
                ends.append((key[0], np.concatenate([[-np.inf], self.edges[key], [np.inf]])))
            cells = [Cell(along, *two) for along, each in ends for two in pairwise(each.tolist())]
            begin = found[-1].part.stop if found else 0
            found.append(Column(name, number, cells, slice(begin, begin + len(cells))))
        return found

    def means(self, trace: Trace, test: Test) -> FloatArray:
        """Return (cells,) means of a rollout; NaN where it has no sample, or lacks the quantity."""
        part = (trace.times - trace.times[0]) / self.duration
        window = np.clip((part * CELLS).astype(int), 0, CELLS - 1)
        rows = self.at[key_of(test)][:, np.clip((part * GRID + 1e-6).astype(int), 0, GRID - 1)]
        along = dict(zip(self.edges, rows.astype(np.intp), strict=True))
        missing = np.full(len(trace), np.nan)
        found = []
        for name, column in _columns(self.widths):
            values = trace[name].reshape(len(trace), -1)[:, column] if name in trace.channels else missing
            found.append(averaged(values, window, CELLS))
            for key in self._beside(name, column):
                found.append(averaged(values, along[key], len(self.edges[key]) + 1))
        return np.concatenate(found)


def _columns(widths: Mapping[str, int]) -> list[tuple[str, int]]:
    return [(name, column) for name, width in widths.items() for column in range(width)]


def path(widths: Mapping[str, int], bench: Bench, trace: Trace, test: Test) -> FloatArray:
    """Return (GRID, columns) the quantities of a rollout at the times of the grid; the last ones after its end."""
    seen = bench.seen(trace, test)
    grid = np.arange(GRID) / GRID * bench.backend.duration
    sample = np.clip(np.searchsorted(seen.times - seen.times[0], grid - 1e-9), 0, len(seen) - 1)
    return np.column_stack([seen[name].reshape(len(seen), -1)[sample] for name in widths])


def averaged(values: FloatArray, place: NDArray[np.intp], count: int) -> FloatArray:
    """Return (count,) means of (n,) values by their place; NaN where there is none."""
    there = np.isfinite(values)
    counts = np.bincount(place[there], minlength=count)
    sums = np.bincount(place[there], values[there], minlength=count)
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
