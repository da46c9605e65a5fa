"""Unevenness of the ground, from the distances of footholds to the plane through all of them.

Data: heights of footholds, one for each stretch of time in which a foot stood. The plane absorbs the common part: a
slope, a soft ground, a wrong origin of the height, and also a part of the unevenness. Model: heights are Gaussian with
covariance K on ground of unit roughness. R is the residual operator of the plane (least squares, weighted by the
duration of each stand). Then the distances from the plane have the covariance R K Rᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_sim.plant.terrain import covariance
from s2r_sim.robot.constants import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Footing:
    """The m stretches of time in which one foot stood.

    Attributes:
        of: (ticks, 4) number of the stretch in which a foot stands, −1 where it does not stand.
        weight: (m,) duration of each stretch [ticks].
        about: (m, m) the operator R: heights minus the plane through them.
        expected: (m,) mean distance from the plane on ground of unit roughness.
    """

    of: IntArray
    weight: FloatArray
    about: FloatArray
    expected: FloatArray

    def mean(self, values: FloatArray) -> FloatArray:
        """Return (m,) means of (ticks, 4) values over each stretch."""
        stands = self.of >= 0
        return np.bincount(self.of[stands], values[stands], len(self.weight)) / self.weight

    def spread(self, values: FloatArray) -> FloatArray:
        """Return (ticks, 4) the value of (m,) at the ticks of its stretch; 0 where no foot stands."""
        return np.append(values, 0.0)[self.of]


def footing(touches: FloatArray, x: FloatArray, y: FloatArray) -> Footing:
    """Return the stretches of time over which feet stood.

    Args:
        touches: (ticks, feet) 1 where a foot is on the ground.
        x: (ticks, feet) position of the foot [m]; used only where it touches.
        y: the same along y [m].
    """
    stands = touches > 0.0
    begins = stands & ~np.vstack((np.zeros_like(stands[:1]), stands[:-1]))
    # One foot after the other, so that a stretch is one run of numbers.
    number = np.cumsum(begins.T.ravel(), dtype=np.int64).reshape(begins.T.shape).T - 1
    of: IntArray = np.where(stands, number, -1)
    count = int(begins.sum())
    weight = np.bincount(of[stands], minlength=count).astype(np.float64)
    bare = Footing(of, weight, np.eye(count), np.zeros(count))
    place = np.column_stack((bare.mean(x), bare.mean(y)))
    plane = np.column_stack((np.ones(count), place))
    root = np.sqrt(weight)
    about = np.eye(count) - plane @ np.linalg.pinv(root[:, None] * plane) * root
    dx, dy = (each[:, None] - each for each in place.T)
    variance = np.einsum("ij,jk,ik->i", about, covariance(dx, dy), about)
    return Footing(of, weight, about, np.sqrt(2.0 / np.pi * np.maximum(variance, 0.0)))
