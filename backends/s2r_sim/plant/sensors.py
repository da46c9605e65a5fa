"""The controller's measurements of the true state: noise, systematic errors, the velocity estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from s2r_sim.controller import estimator
from s2r_sim.controller.estimator import Estimate
from s2r_sim.controller.gains import Feedback
from s2r_sim.controller.qp import Stance
from s2r_sim.plant.noise import Draws
from s2r_sim.plant.physics import Physics
from s2r_sim.robot.constants import FloatArray, Robot
from s2r_sim.robot.signals import RobotState


class SensorMemory(NamedTuple):
    """The last estimate, and the last true velocity (3,) [m/s]: an accelerometer averages between two ticks."""

    estimate: Estimate
    velocity: FloatArray


class Sensors:
    """Measurements of the robot, tick by tick.

    With ``feedback="estimate"`` the velocity estimate is computed at every tick;
    otherwise once for the whole rollout, in a tenth of the time.
    """

    def __init__(self, robot: Robot, physics: Physics, feedback: Feedback) -> None:
        self._robot, self._physics, self._feedback = robot, physics, feedback
        bias = np.zeros(36)
        bias[3:5] = np.radians(physics.attitude_bias)
        bias[12:24] = np.tile(physics.encoder_offset, 4)
        self._bias = bias if bias.any() else None
        self._velocity_is_right = physics.velocity_scale == 1.0 and not any(physics.velocity_bias)
        self._exact = self._bias is None and not physics.backlash and self._velocity_is_right
        self.begin(None, None)

    def begin(self, random: Draws | None, memory: SensorMemory | None) -> None:
        """Start a rollout with this noise and this memory, or without."""
        self._random = random
        self.memory = memory
        self._truth: list[FloatArray] = []
        self._measured: list[FloatArray] = []
        self._stance: list[Stance] = []
        self._own: list[Sequence[float]] = []

    def reported(self, truth: RobotState, play: tuple[FloatArray, FloatArray]) -> RobotState:
        """Return the state as encoders, IMU and velocity feedback report it, without their white noise.

        The motors' own loops act on this state, and a robot logs it. Position and yaw are true; without sensor errors
        it is ``truth`` itself. ``play`` is the angle [rad] and the speed of the rotors, which carry the encoders.
        """
        if self._exact:
            return truth
        own = self.disturbed(truth, play, None)
        own.velocity[:] = self._distorted(truth.velocity.tolist(), float(truth.rpy[2]))
        return own

    def disturbed(
        self, truth: RobotState, play: tuple[FloatArray, FloatArray], noise: FloatArray | None
    ) -> RobotState:
        """Return the state with all errors of encoders and IMU; ``noise`` is (36,) white, or none.

        ``play`` is the angle [rad] and the speed of the rotors, which carry the encoders.
        """
        flat = truth.flat.copy() if noise is None else truth.flat + noise
        if self._bias is not None:
            flat += self._bias
        if self._physics.backlash:
            flat[12:24] += play[0]
            flat[24:36] += play[1]
        return RobotState(flat)

    def read(self, truth: RobotState, play: tuple[FloatArray, FloatArray], stance: Stance) -> RobotState:
        """Return the controller's measurement of the state; for ``play`` see :meth:`disturbed`."""
        tick = len(self._truth)
        measured = self.disturbed(truth, play, None if self._random is None else self._random.sensors[tick])
        self._truth.append(truth.flat)
        self._measured.append(measured.flat)
        self._stance.append(stance)
        if self._feedback == "estimate":
            self._feed_back(truth, measured, tick)
        elif not self._velocity_is_right:
            measured.velocity[:] = self._distorted(measured.velocity.tolist(), float(measured.rpy[2]))
        return measured

    def _feed_back(self, truth: RobotState, measured: RobotState, tick: int) -> None:
        memory = self.memory
        noise = (0.0, 0.0, 0.0) if self._random is None else self._random.accelerometer[tick].tolist()
        change = (truth.velocity - (truth.velocity if memory is None else memory.velocity)).tolist()
        force = estimator.specific_force(truth.rpy.tolist(), change, noise, math.sin, math.cos)
        before = None if memory is None else memory.estimate
        estimate = estimator.update(self._robot, before, measured, force, self._stance[-1])
        self.memory = SensorMemory(estimate, truth.velocity)
        own = self._distorted(estimate.velocity, float(measured.rpy[2]))
        self._own.append(own)
        measured.position[:] = estimate.position
        measured.velocity[:] = own

    def estimates(self) -> FloatArray:
        """Return (n, 3) the robot's own estimate of its velocity [m/s], world axes, at every tick so far."""
        if self._feedback == "estimate":
            return np.array(self._own)
        truth, measured = RobotState(np.array(self._truth).T), RobotState(np.array(self._measured).T)
        n = len(self._truth)
        noise = np.zeros((n, 3)) if self._random is None else self._random.accelerometer[:n]
        change = np.diff(truth.velocity, axis=1, prepend=truth.velocity[:, :1])
        force = estimator.specific_force(truth.rpy, list(change), noise.T, np.sin, np.cos)
        own = estimator.replay(self._robot, measured, force, np.array(self._stance, dtype=float).T)
        return np.array(self._distorted(own.T, measured.rpy[2], np.sin, np.cos)).T

    def _distorted(
        self, velocity: Sequence[Any] | FloatArray, yaw: Any, sin: Any = math.sin, cos: Any = math.cos
    ) -> Sequence[Any]:
        """Return a velocity [m/s] with the errors of scale and bias."""
        x, y, z = velocity
        if self._velocity_is_right:
            return x, y, z
        scale, (forward, left) = self._physics.velocity_scale, self._physics.velocity_bias
        c, s = cos(yaw), sin(yaw)
        return scale * x + c * forward - s * left, scale * y + s * forward + c * left, z
