"""The system under test, and the only door to it: the simulator's controller and its velocity estimator.

Everything that this package takes from ``s2r_sim`` passes through here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_sim.controller.estimator import replay
from s2r_sim.controller.gains import Gains
from s2r_sim.controller.trot import Controller, Memory
from s2r_sim.robot.constants import A1, LEGS
from s2r_sim.robot.signals import RobotState, VelocityCommand

FloatArray = NDArray[np.float64]

__all__ = ["A1", "LEGS", "Brain", "Decision", "Memory", "own_velocity"]

BASE_HEIGHT = Gains().base_height
PERIOD = round(Gains().period * 500)
"""Control ticks of a gait period."""


class Decision(NamedTuple):
    """What one control tick decided.

    Attributes:
        motors: (5, 12) q, q̇, Kp, Kd, τ of the motor law.
        stance: which feet the clock has on the ground.
        base: (6,) predicted spatial acceleration of the base, base axes; zeros without a solution.
        iterations: of the QP's solver.
        solved: whether it found one.
    """

    motors: FloatArray
    stance: tuple[bool, bool, bool, bool]
    base: FloatArray
    iterations: int
    solved: bool


class Brain:
    """The controller, fed with (36,) measured numbers: position, rpy, velocity, ω (base axes), q, q̇."""

    def __init__(self) -> None:
        self._controller = Controller(A1, Gains(), "condensed")

    def restart(self, memory: Memory | None = None) -> None:
        """Forget everything, or continue from what :meth:`snapshot` gave."""
        self._controller.restore(Memory() if memory is None else memory)

    def snapshot(self) -> Memory:
        """Return all that the controller carries from tick to tick."""
        return self._controller.snapshot()

    def tick(self, measured: FloatArray, command: float) -> Decision:
        """Run one control tick under a forward velocity command [m/s]."""
        done = self._controller.tick(RobotState(measured), VelocityCommand(command))
        solution = done.solution
        return Decision(
            np.array(done.motors),
            done.stance,
            np.zeros(6) if solution is None else solution.base,
            0 if solution is None else solution.iterations,
            solution is not None,
        )


def own_velocity(measured: FloatArray, force: FloatArray, stance: FloatArray) -> FloatArray:
    """Return (n, 3) the robot's own estimate of its velocity, world axes.

    From (n, 36) measurements, (n, 3) accelerometer readings in base axes and
    (n, 4) stance flags.
    """
    return replay(A1, RobotState(measured.T), list(force.T), stance.T)
