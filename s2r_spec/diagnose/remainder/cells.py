"""Where a quantity is averaged: windows of time, and equal parts of what a channel did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.gap import LEVEL
from s2r_spec.diagnose.gap.body import CELLS, averaged
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Places = Mapping[tuple[str, int], NDArray[np.intp]]
"""(channel, column) → (n,) in which of the cells along it each sample is."""

FEWEST_ROLLOUTS = 5
"""Definition: rollouts that reach into a cell at least. Twice as many say nothing of cells that few tests reach."""


@dataclass(frozen=True)
class Cells:
    """Where quantities are averaged: in windows of time, and between values of the channels of their width.

    Attributes:
        duration: of a rollout [s].
        widths: quantity → columns.
        edges: (channel, column) → rising values between the cells.
    """

    duration: float
    widths: Mapping[str, int]
    edges: Mapping[tuple[str, int], FloatArray]

    @classmethod
    def of(cls, duration: float, widths: Mapping[str, int], traces: Sequence[Trace]) -> Cells:
        """Choose the edges along recorded channels, with as many samples of these traces between each two.

        They are half as many as windows of time.
        """
        edges = {}
        for name, width in widths.items():
            if name.startswith(RESIDUAL):
                continue
            known = [trace[name].reshape(len(trace), -1) for trace in traces if name in trace.channels]
            for column in range(width):
                values = np.concatenate([each[:, column] for each in known]) if known else np.zeros(0)
                values = values[np.isfinite(values)]
                if values.size:
                    parts = np.quantile(values, np.linspace(0.0, 1.0, CELLS // 2 + 1)[1:-1])
                    edges[name, column] = np.unique(parts)
        return cls(duration, dict(widths), edges)

    def places(self) -> list[tuple[str, int, str, float, float]]:
        """Return quantity, column, channel ("" for time), and the two ends of every cell, as :meth:`means` has them."""
        out = []
        windows = np.linspace(0.0, self.duration, CELLS + 1)
        for name, width in self.widths.items():
            for column in range(width):
                out += [(name, column, "", float(a), float(b)) for a, b in pairwise(windows)]
                for (channel, _), edges in self._beside(width, column):
                    ends = np.concatenate([[-np.inf], edges, [np.inf]])
                    out += [(name, column, channel, float(a), float(b)) for a, b in pairwise(ends)]
        return out

    def columns(self) -> NDArray[np.intp]:
        """Return (cells,) the number of each one's column, of all quantities'."""
        numbers: dict[tuple[str, int], int] = {}
        return np.array([numbers.setdefault(place[:2], len(numbers)) for place in self.places()], dtype=int)

    def within(self, trace: Trace, times: FloatArray) -> Places:
        """Return the cell of each of (n,) times from the begin [s], along the channels of a trace."""
        sample = np.clip(np.searchsorted(trace.times - trace.times[0], times - 1e-9), 0, len(trace) - 1)
        return {
            (channel, column): np.searchsorted(
                edges, trace.channels[channel].reshape(len(trace), -1)[sample, column]
            )
            for (channel, column), edges in self.edges.items()
            if channel in trace.channels
        }

    def means(self, values: Sequence[FloatArray], times: FloatArray, along: Places) -> FloatArray:
        """Return (cells,) means of a rollout; NaN where there is no sample.

        Args:
            values: (n, columns) of each quantity, in the order of ``widths``.
            times: (n,) from the begin of the rollout [s].
            along: (n,) the cell of each sample along every channel; one that is missing has none.
        """
        window = np.clip((times / self.duration * CELLS).astype(int), 0, CELLS - 1)
        out = []
        for width, rows in zip(self.widths.values(), values, strict=True):
            for column, each in enumerate(rows.T):
                out.append(averaged(each, window, CELLS))
                for key, edges in self._beside(width, column):
                    nothing = np.full(len(edges) + 1, np.nan)
                    out.append(averaged(each, along[key], len(nothing)) if key in along else nothing)
        return np.concatenate(out)

    def _beside(self, width: int, column: int) -> list[tuple[tuple[str, int], FloatArray]]:
        return [
            (key, edges)
            for key, edges in self.edges.items()
            if self.widths[key[0]] == width and key[1] == column
        ]


def quantities_of(traces: Sequence[Trace]) -> dict[str, int]:
    """Return quantity → columns of all that is recorded in these traces, with residuals, and is no flag of 0 and 1."""
    found = {}
    for name in traces[0].channels:
        values = [trace[name] for trace in traces if name in trace.channels]
        flag = all(np.isin(x, (0.0, 1.0)).all() for x in values)
        if len(values) == len(traces) and all(np.isfinite(x).all() for x in values) and not flag:
            found[name] = values[0].reshape(len(values[0]), -1).shape[1]
    return found


def over_column(squares: FloatArray, column: NDArray[np.intp]) -> FloatArray:
    """Return (cells,) the mean of (cells,) over each one's column."""
    counts = np.bincount(column, np.isfinite(squares))
    return np.asarray((np.bincount(column, np.nan_to_num(squares)) / np.maximum(counts, 1))[column])


def beyond(
    apart: FloatArray, systematic: FloatArray, asked: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return (cells,) what is left, and that in units of what is allowed for; 0 where a cell says nothing.

    Args:
        apart: (n, cells) what is left of the machine and not of the simulator, of n rollouts.
        systematic: (cells,) squares of what no number of rollouts averages out.
        asked: (cells,) which say something.
    """
    from scipy.stats import t  # here: a rollout needs no scipy

    n = np.isfinite(apart).sum(axis=0)
    size = np.nanmean(apart, axis=0)
    scatter = np.nanstd(apart, axis=0, ddof=1) / np.sqrt(n)
    surely = t.ppf(1.0 - LEVEL / 2.0 / apart.shape[1], np.maximum(n - 1, 1))
    surplus = np.abs(size) / np.hypot(surely * scatter, np.sqrt(systematic))
    return size, np.where((n >= FEWEST_ROLLOUTS) & asked, np.nan_to_num(surplus), 0.0)
