"""Tests over the test space: a grid, and their coordinates in the unit cube."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import UsageError
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

COUNTS = {1: 101, 2: 21, 3: 7, 4: 5}
"""Definition: places along each axis of a space of so many parameters; over five, a grid would have too few. Doubled,
the worst test is known twice as finely."""


def grid_of(space: Space) -> FloatArray:
    """Return the grid (m, dim) over the test space.

    Raises:
        UsageError: the space has no or more than four parameters.
    """
    if space.dim not in COUNTS:
        raise UsageError(
            f"s2r locates the gap in a test space of one to four parameters, and the spec has {space.dim}"
        )
    return space.grid((COUNTS[space.dim],) * space.dim)


def in_cube(space: Space, points: FloatArray) -> FloatArray:
    """Return (n, dim) coordinates of points in the unit cube."""
    scaled: FloatArray = (points - space.lower) / (space.upper - space.lower)
    return scaled
