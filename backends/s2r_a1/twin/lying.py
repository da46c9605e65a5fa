"""The initial state of a twin: lying on its belly, with folded legs and motors off."""

from __future__ import annotations

from functools import lru_cache
from math import inf, radians

import numpy as np
from numpy.typing import NDArray

from s2r_sim.controller.gains import RATE
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant, Saved
from s2r_sim.robot.constants import A1, LEGS
from s2r_sim.robot.signals import MotorCommand

FloatArray = NDArray[np.float64]

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
