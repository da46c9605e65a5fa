"""A division of the test space into cells, refined where the bounds need it.

Bounds are computed at corners. The kernel's interpolation bound for the cell's sides limits how far the function
can rise above them inside the cell.
"""

from __future__ import annotations

import itertools
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.space import Space

IndexArray = NDArray[np.intp]
Lattice = NDArray[np.int64]

MOST_POINTS = 50_000
"""Budget: points after which no cell is split any more."""
DEPTH = 20
"""Definition: how often a cell of the first division can be halved along each axis."""
FIRST_POINTS = 1500
"""Budget: most corners of the first division."""


class Roughness(Protocol):
    """How much a function can rise inside a cell above its corners, axis by axis."""

    def hidden(self, sides: FloatArray) -> FloatArray:
        """Return (…, dim) contributions for (…, dim) cell sides."""

    def sides_for(self, error: float, dim: int) -> FloatArray:
        """Return (dim,) sides whose contributions sum to at most ``error``."""


class Tiling:
    """Cells that cover a box without overlap. Splitting adds points; points are never moved or removed.

    Attributes:
        points: (P, dim) corners of all cells so far, and added points.
        corners: (C, 2^dim) indices into ``points``.
        error: (C,) largest rise above the corners inside each cell; for a kernel, e(h).
    """

    def __init__(self, space: Space, roughness: Roughness, error: float) -> None:
        # No cell hides more than ``error``, or the cells are as fine as FIRST_POINTS corners allow.
        self._space, self._roughness = space, roughness
        widths = space.upper - space.lower
        cells = np.maximum(1.0, np.ceil(widths / roughness.sides_for(error, space.dim)))
        while np.prod(cells + 1) > FIRST_POINTS:
            cells[cells.argmax()] = np.ceil(cells.max() * 0.9) if cells.max() > 9 else cells.max() - 1
        self._counts = cells.astype(np.int64)
        self._offsets: Lattice = np.array(list(itertools.product((0, 1), repeat=space.dim)), dtype=np.int64)
        self._index: dict[bytes, int] = {}
        lines = [np.arange(n, dtype=np.int64) << DEPTH for n in self._counts]
        self._low: Lattice = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, space.dim)
        self._size: Lattice = np.full_like(self._low, 1 << DEPTH)
        self.points: FloatArray = np.zeros((0, space.dim))
        self.corners: IndexArray = self._corners(self._low, self._size)
        self.error: FloatArray = self._errors(self._size)

    def __len__(self) -> int:
        return len(self.corners)

    def splittable(self) -> NDArray[np.bool_]:
        """(C,) whether a cell can still be halved."""
        axis = self._hidden(self._size).argmax(axis=1)
        return np.asarray(np.take_along_axis(self._size, axis[:, None], axis=1)[:, 0] > 1)

    def split(self, cells: IndexArray) -> IndexArray:
        """Halve cells along the axis that contributes most to their error.

        Returns:
            (C',) for every cell after the split, the index before it of the cell that contains it.
        """
        axis = self._hidden(self._size[cells]).argmax(axis=1)
        size = self._size[cells].copy()
        rows = np.arange(len(cells))
        size[rows, axis] //= 2
        upper = self._low[cells].copy()
        upper[rows, axis] += size[rows, axis]
        kept = np.setdiff1d(np.arange(len(self)), cells)
        low, both = np.concatenate([self._low[cells], upper]), np.concatenate([size, size])
        self.corners = np.concatenate([self.corners[kept], self._corners(low, both)])
        self.error = np.concatenate([self.error[kept], self._errors(both)])
        self._low = np.concatenate([self._low[kept], low])
        self._size = np.concatenate([self._size[kept], both])
        return np.concatenate([kept, cells, cells])

    def add(self, vector: FloatArray) -> int:
        """Return the index of a (dim,) vector of the box, and add it as a point if needed; the cells do not change."""
        same = np.flatnonzero((self.points == vector).all(axis=1))
        if len(same):
            return int(same[0])
        self.points = np.concatenate([self.points, vector[None]])
        return len(self.points) - 1

    def containing(self, points: FloatArray) -> IndexArray:
        """Return (n,) a cell that contains each of (n, dim) points of the box."""
        low, high = self._real(self._low).T.copy(), self._real(self._low + self._size).T.copy()
        cells = np.empty(len(points), dtype=np.intp)
        for start in range(0, len(points), 256):  # a bounded block of points × cells at a time
            columns = points[start : start + 256].T[:, :, None]
            inside = np.ones((columns.shape[1], len(self)), dtype=np.bool_)
            for column, least, most in zip(columns, low, high, strict=True):
                inside &= (column >= least) & (column <= most)
            cells[start : start + 256] = inside.argmax(axis=1)
        return cells

    def _corners(self, low: Lattice, size: Lattice) -> IndexArray:
        lattice = (low[:, None] + self._offsets * size[:, None]).reshape(-1, self._space.dim)
        indices = np.empty(len(lattice), dtype=np.intp)
        fresh: list[Lattice] = []
        for i, row in enumerate(lattice):
            following = len(self.points) + len(fresh)
            indices[i] = self._index.setdefault(row.tobytes(), following)
            if indices[i] == following:
                fresh.append(row)
        if fresh:
            self.points = np.concatenate([self.points, self._real(np.array(fresh))])
        return indices.reshape(len(low), -1)

    def _real(self, lattice: Lattice) -> FloatArray:
        share = lattice / (self._counts << DEPTH)
        # Written so that both ends of an axis are hit exactly.
        return np.asarray(self._space.lower * (1 - share) + self._space.upper * share)

    def _hidden(self, size: Lattice) -> FloatArray:
        return self._roughness.hidden(
            (self._space.upper - self._space.lower) * size / (self._counts << DEPTH)
        )

    def _errors(self, size: Lattice) -> FloatArray:
        return np.asarray(self._hidden(size).sum(axis=1))
