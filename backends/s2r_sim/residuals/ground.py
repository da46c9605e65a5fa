"""The ground of a world under a foot: its sinkage and creep under a steady force, and its unevenness.

MuJoCo's contacts have a reference acceleration −b v − k d r and a regularisation
R = (1 − d)/d · Â. The impedance d grows with the depth r (MuJoCo's documentation,
"Computation", constraint model). Without acceleration, k d r = R f under a normal force f,
and b v = (R / impratio) f under a tangential one.

Unevenness, data: heights of footholds, one for each stretch of time in which a foot stood. The plane through them
absorbs the common part: a slope, a soft ground, a wrong origin of the height, and also a part of the unevenness.
Model: heights are Gaussian with covariance K on ground of unit roughness. R is the residual operator of the plane
(least squares, weighted by the duration of each stand). Then the distances from it have the covariance R K Rᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from s2r_sim.plant import mujoco_model
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.terrain import covariance
from s2r_sim.robot.constants import LEGS, FloatArray, Robot

IntArray = NDArray[np.int64]

_DEEPEST = 0.06
"""Greatest depth of the table [m]."""


@dataclass(frozen=True)
class Compliance:
    """Depth and creep of a foot over the normal force in one world, (n,) each, in rising order.

    Attributes:
        force: steady normal force [N].
        depth: sinkage under this force [m].
        creep: creep velocity per tangential force [m/s per N] at this depth.
    """

    force: FloatArray
    depth: FloatArray
    creep: FloatArray

    def depth_under(self, force: FloatArray) -> FloatArray:
        """Return the sinkage [m] under a normal force [N], any shape."""
        return np.asarray(np.interp(force, self.force, self.depth))

    def creep_under(self, force: FloatArray) -> FloatArray:
        """Return the creep [m/s] per newton of tangential force, under a normal force [N], any shape."""
        return np.asarray(np.interp(force, self.force, self.creep))


@lru_cache(maxsize=64)
def ground_compliance(robot: Robot, impratio: float, sink: float) -> Compliance:
    """Return the compliance of a ground under a foot of this robot; see :class:`~s2r_sim.plant.physics.Physics`."""
    model = mujoco_model.build(robot, Physics(impratio=impratio, sink=sink))
    floor = model.geom(mujoco_model.FLOOR)
    constant, _ = floor.solref
    least, most, width, middle, power = floor.solimp
    # Â [1/kg]: inverse of a shank's apparent mass, which MuJoCo estimates once for a model.
    lightness = float(model.body(f"{LEGS[0].name}_calf").invweight0[0])
    depth = np.concatenate([[0.0], np.geomspace(1e-5, _DEEPEST, 200)])
    part = np.clip(depth / width, 0.0, 1.0)
    # MuJoCo's power curve through its middle.
    rising = np.where(
        part <= middle,
        part**power / middle ** (power - 1),
        1.0 - (1.0 - part) ** power / (1.0 - middle) ** (power - 1),
    )
    d = least + (most - least) * rising
    compliance = (1.0 - d) / d * lightness
    stiffness, damping = 1.0 / (most * constant) ** 2, 2.0 / (most * constant)
    return Compliance(d * stiffness * depth / compliance, depth, compliance / impratio / damping)


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
