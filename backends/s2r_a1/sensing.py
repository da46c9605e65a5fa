"""Turn the robot's readings into states for the simulator's controller.

An A1 measures attitude, rates and joints, but not its position and velocity. These are the estimate of
:mod:`s2r_sim.controller.estimator`, from leg odometry, gyroscope and accelerometer. The heading counts from the first
reading, so that the robot starts straight ahead, as in the simulator.
"""

from __future__ import annotations

from math import pi, remainder
from typing import NamedTuple

import numpy as np

from s2r_a1.ticks import SECONDS, TickUnit, elapsed_ticks
from s2r_a1.wire import Reading
from s2r_sim.controller import estimator
from s2r_sim.controller.estimator import Estimate
from s2r_sim.controller.gains import RATE
from s2r_sim.controller.qp import Stance
from s2r_sim.robot.constants import Robot
from s2r_sim.robot.rotation import rpy_from_wxyz
from s2r_sim.robot.signals import RobotState


class Sensed(NamedTuple):
    """The estimated state at one reading.

    Attributes:
        state: state for the controller, in a frame at the robot's start and first heading.
        estimate: estimate of position and velocity, for the next update.
        heading: yaw of the IMU at the first reading [rad].
        tick: the robot's clock at this reading.
    """

    state: RobotState
    estimate: Estimate
    heading: float
    tick: int


def control_ticks(before: int, after: int, unit: TickUnit) -> float:
    """Return the time from one tick of the robot's clock to another, in control ticks of 2 ms."""
    return elapsed_ticks(before, after) * SECONDS[unit] * RATE


def sense(robot: Robot, before: Sensed | None, reading: Reading, stance: Stance, ticks: float) -> Sensed:
    """Return the estimated state at a reading, with the feet that the gait has on the ground (``stance``).

    ``before`` is the estimated state at the last reading, ``ticks`` control ticks of 2 ms ago by the robot's clock.
    """
    w, x, y, z = (reading.quaternion / np.linalg.norm(reading.quaternion)).tolist()
    roll, pitch, yaw = rpy_from_wxyz(w, x, y, z)
    heading = yaw if before is None else before.heading
    flat = np.zeros(36)
    flat[3:6] = roll, pitch, remainder(yaw - heading, 2.0 * pi)
    flat[9:12], flat[12:24], flat[24:] = reading.gyro, reading.q, reading.dq
    state = RobotState(flat)
    fx, fy, fz = reading.accelerometer.tolist()
    previous = None if before is None else before.estimate
    estimate = estimator.update(robot, previous, state, (fx, fy, fz), stance, ticks)
    state.position[:], state.velocity[:] = estimate
    return Sensed(state, estimate, heading, reading.tick)
