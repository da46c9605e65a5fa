"""Bounds of J over the whole box, for several norm bounds at once, from one event of probability 1 − δ.

The confidence set holds for all times at once, so the tightest bound so far
holds. Points and cells keep a running intersection, and the halves of a cell
inherit it. Cells are split where they, and not the data, decide the maximum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.modes import Bound
from s2r_spec.certify.bound.posterior import Conditioned
from s2r_spec.certify.bound.tiling import MOST_POINTS, Tiling


class Bounds:
    """Running bounds at the points and in the cells of a tiling; one row for each norm bound, in units of R.

    Attributes:
        lower: (rungs, P) at the points.
        upper: (rungs, P) at the points.
    """

    def __init__(self, tiling: Tiling, norms: FloatArray) -> None:
        self._tiling, self._norms = tiling, norms  # |J| ≤ ‖J‖ ≤ B needs no data
        self.upper: FloatArray = np.repeat(norms[:, None], len(tiling.points), axis=1)
        self.lower: FloatArray = -self.upper
        self._cell_upper: FloatArray = np.repeat(norms[:, None], len(tiling), axis=1)
        self._cell_lower: FloatArray = -self._cell_upper

    @property
    def best(self) -> FloatArray:
        """(rungs,) lower bound of the maximum: the largest lower bound at a point."""
        return np.asarray(self.lower.max(axis=1))

    @property
    def maximum(self) -> FloatArray:
        """(rungs,) upper bound of the maximum over the box: J^e."""
        return np.asarray(self._cell_upper.max(axis=1))

    @property
    def minimum(self) -> FloatArray:
        """(rungs,) lower bound of the minimum over the box; cells are not split for it."""
        return np.asarray(self._cell_lower.min(axis=1))

    @property
    def hidden(self) -> FloatArray:
        """(rungs,) excess of the maximum over the largest upper bound at a point."""
        return np.asarray(np.maximum(self.maximum - self.upper.max(axis=1), 0))

    @property
    def empty(self) -> bool:
        """Whether bounds of the first row contradict each other; if all assumptions hold this has probability ≤ δ."""
        return bool((self.lower[0] > self.upper[0]).any() or self.best[0] > self.maximum[0])

    def add(self, vector: FloatArray) -> int:
        """Return the index of a (dim,) vector of the box among the points; a new point gets its cell's bounds."""
        place = self._tiling.add(vector)
        if place == self.upper.shape[1]:
            cell = self._tiling.containing(vector[None])
            self.upper = np.concatenate([self.upper, self._cell_upper[:, cell]], axis=1)
            self.lower = np.concatenate([self.lower, self._cell_lower[:, cell]], axis=1)
        return place

    def tighten(self, data: Conditioned, bound: Bound, tolerance: float) -> None:
        """Intersect with the bound from all outcomes so far, and split cells while they hide too much.

        A cell is split while it may exceed every point's upper bound by more than the share ``tolerance`` of the
        interval that is left.
        """
        self._intersect(data, bound, 0)
        while len(self._tiling.points) < MOST_POINTS and not self.empty:
            gap = self.maximum[0] - self.best[0]
            excess = self._cell_upper[0] - self.upper[0].max()
            cells = np.flatnonzero((excess > tolerance * gap) & self._tiling.splittable())
            if not len(cells):
                return
            known = len(self._tiling.points)
            parents = self._tiling.split(cells)
            inherited = self._inherit(known, parents)
            self._cell_upper, self._cell_lower = self._cell_upper[:, parents], self._cell_lower[:, parents]
            self.upper = np.concatenate([self.upper, inherited[0]], axis=1)
            self.lower = np.concatenate([self.lower, inherited[1]], axis=1)
            self._intersect(data, bound, known)

    def at(self, points: FloatArray, data: Conditioned | None, bound: Bound) -> tuple[FloatArray, FloatArray]:
        """Return (rungs, n) lower and upper bounds at any (n, dim) points of the box."""
        cells = self._tiling.containing(points)
        lower, upper = self._cell_lower[:, cells], self._cell_upper[:, cells]
        if data is not None:
            now = _evaluate(data, bound, points)
            lower, upper = np.fmax(lower, now[0]), np.fmin(upper, now[1])
        return lower, upper

    def _inherit(self, known: int, parents: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        fresh = len(self._tiling.points) - known
        upper = np.full((len(self._norms), fresh), np.inf)
        lower = -upper
        for column in self._tiling.corners.T:
            new = column >= known
            for row in range(len(self._norms)):
                np.minimum.at(upper[row], column[new] - known, self._cell_upper[row, parents[new]])
                np.maximum.at(lower[row], column[new] - known, self._cell_lower[row, parents[new]])
        return upper, lower

    def _intersect(self, data: Conditioned, bound: Bound, first: int) -> None:
        """Intersect the bounds of the points from ``first`` on with new ones, and from them those of all cells."""
        points = self._tiling.points if first == 0 else self._tiling.points[first:]
        lower, upper = _evaluate(data, bound, points)
        # fmin and fmax: a norm bound that is refuted bounds nothing, and its row stays.
        self.upper[:, first:] = np.fmin(self.upper[:, first:], upper)
        self.lower[:, first:] = np.fmax(self.lower[:, first:], lower)
        hidden = self._norms[:, None] * self._tiling.error
        corners = self._tiling.corners
        self._cell_upper = np.minimum(self._cell_upper, self.upper[:, corners].max(axis=2) + hidden)
        self._cell_lower = np.maximum(self._cell_lower, self.lower[:, corners].min(axis=2) - hidden)


def _evaluate(data: Conditioned, bound: Bound, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (rungs, n) bounds from one fit; NaN in the rows whose norm bound is refuted."""
    moments = data.moments(bound.scales, points)
    margins = [width[:, None] * moments.std for width in bound.widths]
    return (
        np.stack([(moments.mean - margin).max(axis=0) for margin in margins]),
        np.stack([(moments.mean + margin).min(axis=0) for margin in margins]),
    )
