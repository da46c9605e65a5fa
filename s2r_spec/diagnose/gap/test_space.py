"""Tests over the test space: where to simulate, and how a value at some tests becomes one between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from s2r_spec.space import Space

FloatArray = NDArray[np.float64]


def unit_box(space: Space, tests: Sequence[Mapping[str, float]]) -> FloatArray:
    """Return (n, dim) coordinates in [−1, 1] of tests in the space's units."""
    if space.dim == 0:
        return np.zeros((len(tests), 0))
    points = np.array([[test[name] for name in space.names] for test in tests], dtype=np.float64)
    return 2.0 * (points.reshape(len(tests), space.dim) - space.lower) / (space.upper - space.lower) - 1.0


def grid(space: Space) -> list[dict[str, float]]:
    """Return tests over the space.

    Seven equal steps on a line; in more dimensions the corners and a Sobol
    sequence, 14 points in 2 dimensions and 26 in 3 and 4.
    """
    if space.dim == 0:
        return [{}]
    if space.dim == 1:
        points = np.linspace(-1.0, 1.0, 7)[:, None]
    else:
        from scipy.stats import qmc

        corners = np.array(list(product((-1.0, 1.0), repeat=space.dim)))
        inner = 6 + 2 * space.dim * (space.dim - 1) if space.dim < 4 else 10
        sobol = qmc.Sobol(space.dim, scramble=True, rng=0).random_base2(int(np.ceil(np.log2(inner))))[:inner]
        points = np.concatenate([corners, 0.9 * (2.0 * sobol - 1.0)])
    return [space.point(p) for p in space.at((points + 1.0) / 2.0)]


def weights(known: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return (wanted, known) weights with which values at known points become values at wanted ones.

    Piecewise linear on a line; in more dimensions the biharmonic-free linear
    radial basis with a linear trend (scipy's RBFInterpolator), which
    reproduces every linear function of the test.
    """
    if known.shape[1] == 0 or len(known) == 1:
        return np.full((len(wanted), len(known)), 1.0 / len(known))
    identity = np.eye(len(known))
    if known.shape[1] == 1:
        order = np.argsort(known[:, 0])
        x = np.clip(wanted[:, 0], -1.0, 1.0)
        return np.stack(
            [np.interp(x, known[order, 0], identity[i, order]) for i in range(len(known))], axis=1
        )
    from scipy.interpolate import RBFInterpolator

    found: FloatArray = RBFInterpolator(known, identity, kernel="linear", degree=1)(wanted)
    return found
