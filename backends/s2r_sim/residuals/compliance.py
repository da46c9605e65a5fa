"""Sinkage and creep of a foot on the ground of a world, under a steady force.

MuJoCo's contacts have a reference acceleration −b v − k d r and a regularisation
R = (1 − d)/d · Â. The impedance d grows with the depth r (MuJoCo's documentation,
"Computation", constraint model). Without acceleration, k d r = R f under a normal force f,
and b v = (R / impratio) f under a tangential one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from s2r_sim.plant import mujoco_model
from s2r_sim.plant.physics import Physics
from s2r_sim.robot.constants import LEGS, FloatArray, Robot

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
