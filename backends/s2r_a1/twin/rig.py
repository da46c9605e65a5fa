"""A rig that holds the base of a twin level at a height, so that the legs hang free.

Model: rig and trunk are one body of ``RIG`` kg, as in the simulator's protocols, and carried by its weight. After every
round the base is put back to its place, since over minutes a small error of the weight would move it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant
from s2r_sim.protocols.simulator import RIG
from s2r_sim.robot.constants import A1, GRAVITY, LEGS

FloatArray = NDArray[np.float64]


class Rig:
    """A plant on level ground whose base a rig holds by a force ``lift`` (3,) [N]."""

    def __init__(self, physics: Physics, height: float, q: FloatArray) -> None:
        """Hold the base at a height [m] above the ground, with the joints at (12,) angles q [rad]."""
        self.physics = replace(physics, slope=0.0, roughness=0.0)
        self.plant = plant = Plant(A1, self.physics, knees=True)
        base = int(plant.model.body("base").id)
        plant.model.body_mass[base] = RIG
        plant.model.body_inertia[base] = RIG
        import mujoco

        mujoco.mj_setConst(plant.model, plant.data)
        plant.place(np.array([0.0, 0.0, height]), np.zeros(3), q)
        legs = len(LEGS) * (A1.hip.mass + A1.thigh.mass + A1.shank.mass)
        self.lift = np.array([0.0, 0.0, (RIG + legs) * GRAVITY])
        self._pose = plant.data.qpos[:7].copy()

    def hold(self) -> None:
        """Put the base back to its place, at rest."""
        self.plant.data.qpos[:7] = self._pose
        self.plant.data.qvel[:6] = 0.0
