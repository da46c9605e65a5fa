"""Where a twin is put: on its belly with folded legs and motors off, or into a rig that holds its base level.

Model of the rig: rig and trunk are one body of ``RIG`` kg, as in the simulator's protocols, and carried by its weight.
After every round the base is put back to its place, since over minutes a small error of the weight would move it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import inf, radians

import numpy as np

from s2r_a1.wire import FloatArray
from s2r_sim.controller.gains import RATE
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant, Saved
from s2r_sim.protocols.simulator import RIG
from s2r_sim.robot.constants import A1, GRAVITY, LEGS
from s2r_sim.robot.signals import MotorCommand

HIP, THIGH, CALF = 0.5, 1.35, -2.69
"""A definition: angles of a folded leg [rad], with the hip outwards. The calves are at their limit, as on a robot that
lies. The hip is out so far that knees and feet touch the ground beside the trunk. The robot settles from these angles,
and the twin begins in the settled pose."""
FOLDED = np.concatenate([[leg.sy * HIP, THIGH, CALF] for leg in LEGS])
"""A definition: (12,) angles of folded legs [rad]."""
_ABOVE = 0.08
"""A tolerance [m]: height of the base before it settles; it lies at 0.057 m, half the trunk's height."""
_HELD, _DAMPED, _LIMP = 0.3, 0.7, 3.0
"""Budgets [s]: times of holding, braking and releasing the legs."""
_RELEASED = np.zeros(12)


@lru_cache(maxsize=16)
def lying_state(physics: Physics) -> Saved:
    """Return the state of a robot that lies still; the same for all twins of a place."""
    plant = Plant(A1, physics, knees=True)
    plant.place(np.array([0.0, 0.0, _ABOVE]), np.array([0.0, -radians(physics.slope), 0.0]), FOLDED)
    for seconds, kp, kd in ((_HELD, 5.0, 1.0), (_DAMPED, 0.0, 3.0), (_LIMP, 0.0, 0.0)):
        law = MotorCommand(FOLDED, _RELEASED, np.full(12, kp), np.full(12, kd), _RELEASED)
        for _ in range(round(seconds * RATE)):
            plant.step(law, -inf)
    return plant.save()


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
