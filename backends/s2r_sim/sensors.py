"""From the truth to what the controller is given: noise, systematic errors, the velocity estimate."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_sim import estimator, rotation
from s2r_sim.estimator import Estimate, Vector
from s2r_sim.figures import GRAVITY, Robot
from s2r_sim.gains import RATE
from s2r_sim.physics import Physics, State
from s2r_sim.qp import Stance
from s2r_sim.settings import Feedback

FloatArray = NDArray[np.float64]


class SensorMemory(NamedTuple):
    """The last estimate, and the last true velocity (3,): an IMU integrates between two ticks."""

    estimate: Estimate
    velocity: FloatArray


class Sensors:
    """What the robot measures, tick by tick; begins with no memory or with a saved one."""

    def __init__(self, robot: Robot, physics: Physics, feedback: Feedback) -> None:
        self._robot, self._physics, self._feedback = robot, physics, feedback
        bias = np.zeros(36)
        bias[3:5] = np.radians(physics.attitude_bias)
        bias[12:24] = np.tile(physics.encoder_offset, 4)
        self._bias = bias if bias.any() else None
        self._velocity_is_right = physics.velocity_scale == 1.0 and not any(physics.velocity_bias)
        self.memory: SensorMemory | None = None

    def read(
        self,
        truth: State,
        play: tuple[FloatArray, FloatArray],
        stance: Stance,
        noise: tuple[FloatArray, FloatArray] | None,
    ) -> tuple[State, Sequence[float]]:
        """Return the state as the controller is given it, and the robot's own estimate of its velocity.

        ``play`` is that of the rotors, where the encoders sit; ``noise`` the
        tick's (36,) errors of the state and (3,) of the accelerometer.
        """
        flat = truth.flat.copy() if noise is None else truth.flat + noise[0]
        if self._bias is not None:
            flat += self._bias
        if self._physics.backlash:
            flat[12:24] += play[0]
            flat[24:36] += play[1]
        measured = State(flat)
        before = None if self.memory is None else self.memory.estimate
        force = self._specific_force(truth, noise)
        estimate = estimator.update(self._robot, before, measured, force, stance)
        self.memory = SensorMemory(estimate, truth.velocity)
        own = self._distorted(estimate.velocity, measured)
        if self._feedback == "estimate":
            measured.position[:] = estimate.position
            measured.velocity[:] = own
        else:
            measured.velocity[:] = self._distorted(measured.velocity.tolist(), measured)
        return measured, own

    def _specific_force(self, truth: State, noise: tuple[FloatArray, FloatArray] | None) -> Vector:
        """Return what an accelerometer reads on average since the last tick [m/s²], base axes."""
        last = truth.velocity if self.memory is None else self.memory.velocity
        force = (truth.velocity - last) * RATE
        force[2] += GRAVITY
        force = force @ rotation.matrix(*truth.rpy.tolist())
        if noise is not None:
            force += noise[1]
        x, y, z = force.tolist()
        return (x, y, z)

    def _distorted(self, velocity: Sequence[float], measured: State) -> Sequence[float]:
        """Return a velocity [m/s] with the errors of scale and bias on it."""
        if self._velocity_is_right:
            return velocity
        yaw = float(measured.rpy[2])
        scale, (forward, left) = self._physics.velocity_scale, self._physics.velocity_bias
        c, s = cos(yaw), sin(yaw)
        x, y, z = velocity
        return (scale * x + c * forward - s * left, scale * y + s * forward + c * left, z)
