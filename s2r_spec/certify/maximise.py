"""A certified maximum over the box: a grid, and what can hide between its points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.certify.kernels import Kernel
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

MOST_POINTS = 20_000


@dataclass(frozen=True)
class Grid:
    """(G, dim) corner points of a division of the box into equal cells, with its interpolation bound."""

    points: FloatArray
    interpolation: float
    """e(h): for ‖J‖ ≤ B, max over the box ≤ max over the points + B e(h)."""


def grid_for(space: Space, kernel: Kernel, error: float) -> Grid:
    """Return the coarsest grid with e(h) ≤ ``error``, or the finest one of at most MOST_POINTS points.

    In the second case e(h) is larger than asked; it is stated in every
    certificate, which stays valid and becomes wider.
    """
    widths = space.upper - space.lower
    steps = kernel.steps_for(error, space.dim)
    cells = np.maximum(1, np.ceil(widths / steps))
    if np.prod(cells + 1) > MOST_POINTS:
        low, high = 1.0, float(cells.max())
        while high - low > 1e-6 * high:
            factor = math.sqrt(low * high)
            if np.prod(np.ceil(np.maximum(1, cells / factor)) + 1) > MOST_POINTS:
                low = factor
            else:
                high = factor
        cells = np.ceil(np.maximum(1, cells / high))
    return Grid(
        points=space.grid(tuple(int(n) + 1 for n in cells)),
        interpolation=kernel.interpolation(widths / cells),
    )
