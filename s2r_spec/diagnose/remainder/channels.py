"""What a machine does that the improved simulator does not, in its channels and in the residuals of its equations.

A residual shows where a cause acts. In a closed loop what acts in one window goes on in the next, and all that the
machine does otherwise is in its channels, so a difference there says less.

The cells lie where another rollout of the improved simulator at the same test was at the time: where it had this
speed, or that force. Cells by what each rollout itself did would differ wherever the channel that bounds them does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.remainder.cells import Cells, beyond, over_column
from s2r_spec.diagnose.simulate import Bench, Test
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Key = tuple[tuple[str, float], ...]

LAWS = 0.3
"""Prior: laws are off by this part of what the named effects do in a cell, and next to it. Doubled, less is left of a
machine with large effects."""
ALLOWED = 0.1
"""Prior: a little of everything is this part of every typical effect. Doubled, causes half as large are allowed for."""
NOTHING = 0.03
"""Tolerance: nobody models a channel better than to this part of how much it varies. Doubled, smaller causes hide."""
TAIL = 0.2
"""Definition: the largest of many columns of a machine that is the simulator's in kind is 1 + TAIL · log(columns) times
allowed. Doubled, machines of many columns show less."""
BESIDE = 0.5
"""Level: part of a surplus of a channel that counts where there are residuals, which show most of it, and more sharply;
and part of the largest surplus in a column that the first window of time has where it begins. Doubled, channels count
as residuals, and the begin is the largest."""
GRID = 1000
"""Definition: times of a rollout at which it is known in which cell it is. Doubled, cells have sharper ends."""


@dataclass(frozen=True)
class Beside:
    """Cells, and where they are at every test.

    Attributes:
        cells: along channels.
        at: test → (channels' columns, GRID) the cell at each time, in the order of the cells' edges.
    """

    cells: Cells
    at: Mapping[Key, NDArray[np.uint8]]

    @classmethod
    def of(
        cls, duration: float, widths: Mapping[str, int], tests: Sequence[Test], paths: Sequence[FloatArray]
    ) -> Beside:
        """Take :meth:`Path` of a rollout at every test."""
        times = _grid(duration)
        ends = np.cumsum(list(widths.values()))[:-1]
        runs = [
            Trace(times, dict(zip(widths, np.split(rows.reshape(GRID, -1), ends, axis=1), strict=True)), {})
            for rows in paths
        ]
        cells = Cells.of(duration, widths, runs)
        at = {}
        for test, run in zip(tests, runs, strict=True):
            along = cells.within(run, times)
            at[key_of(test)] = np.array([along[key] for key in cells.edges], dtype=np.uint8)
        return cls(cells, at)

    def averaged(self, trace: Trace, test: Test) -> FloatArray:
        """Return (cells,) means of a rollout; NaN where it lacks the channel."""
        times = trace.times - trace.times[0]
        place = np.clip((times / self.cells.duration * GRID + 1e-6).astype(int), 0, GRID - 1)
        rows = self.at[key_of(test)][:, place].astype(np.intp)
        missing = np.full(len(trace), np.nan)
        values = [
            trace.channels.get(name, np.repeat(missing, width)).reshape(len(trace), width)
            for name, width in self.cells.widths.items()
        ]
        return self.cells.means(values, times, dict(zip(self.cells.edges, rows, strict=True)))


@dataclass(frozen=True)
class Path:
    """Reads (GRID · columns,) the quantities of a rollout at the times of the grid; the last ones after its end."""

    widths: Mapping[str, int]

    def __call__(self, bench: Bench, trace: Trace, test: Test) -> FloatArray:
        """Return them of one rollout."""
        trace = bench.seen(trace, test)
        times = trace.times - trace.times[0]
        sample = np.clip(np.searchsorted(times, _grid(bench.backend.duration) - 1e-9), 0, len(trace) - 1)
        return np.column_stack([trace[name].reshape(len(trace), -1)[sample] for name in self.widths]).ravel()


def _grid(duration: float) -> FloatArray:
    return np.arange(GRID) / GRID * duration


def left_over(
    machine: FloatArray,
    own: FloatArray,
    nominal: FloatArray,
    explained: FloatArray,
    typical: Sequence[FloatArray],
    numerics: Sequence[FloatArray],
    cells: Cells,
) -> tuple[FloatArray, FloatArray]:
    """Return (cells,) what the machine does and the simulator does not, and that in units of what is allowed for.

    Args:
        machine: (n, cells) n rollouts.
        own: (n, cells) the improved simulator at the same tests.
        nominal: (m, cells) the nominal one, at few tests.
        explained: (m, cells) what the improved one does beside it, of the same noise.
        typical: (l, cells) what each typical effect does, at fewer.
        numerics: (m, cells) what each variant of the simulator does, too.
        cells: where that is.
    """
    column = cells.columns()

    def squared(changes: Sequence[FloatArray]) -> FloatArray:
        found = [np.nan_to_num(np.nanmean(each**2, axis=0)) for each in changes]
        return np.sum(found, axis=0) if found else np.zeros(len(column))

    usual, little, other = squared([explained]), squared(typical), squared(numerics)
    # Windows alone show how much a channel varies: of other cells there are many where it does not.
    windows = np.array([not along for _, _, along, *_ in cells.places()])
    mean = over_column(np.where(windows, np.nanmean(nominal, axis=0), np.nan), column)
    varies = over_column(np.where(windows, np.nanmean((nominal - mean) ** 2, axis=0), np.nan), column)
    systematic = (
        LAWS**2 * (usual + over_column(usual, column))
        + ALLOWED**2 * over_column(little, column)
        + NOTHING**2 * varies
        + other
    )
    # What no effect moves, as a reference, is no part of the machine.
    moved = over_column(little, column) > NOTHING**2 * varies
    size, surplus = beyond(machine - own, systematic, moved)
    largest = 1.0 + TAIL * np.log(max(len(np.unique(column[moved])), 1))
    return size, surplus / largest


def begin(places: Sequence[tuple[str, int, str, float, float]], surplus: FloatArray) -> FloatArray:
    """Return (cells,) surplus, with 0 in windows of time after the first that says (nearly) as much.

    In a closed loop what acts for a time goes on after it, and the answer to it may be the larger.
    """
    out = surplus.copy()
    largest: dict[tuple[str, int], float] = {}
    for place, value in zip(places, surplus, strict=True):
        largest[place[:2]] = max(largest.get(place[:2], 0.0), float(value))
    begun: set[tuple[str, int]] = set()
    for k, (name, column, along, *_) in enumerate(places):
        if not along and (name, column) in begun:
            out[k] = 0.0
        elif not along and surplus[k] > max(1.0, BESIDE * largest[name, column]):
            begun.add((name, column))
    return out
