"""The robot's estimate of its own velocity: leg odometry and inertial measurement, blended.

A standing foot's ball rolls: its centre, a radius r above the ground, moves at
ω_shank × r ẑ and not at zero. Without that term the trot reads 7 % too slow.

The formulas take the numbers of one tick (with ``sin`` and ``cos`` of ``math``),
or arrays of a whole recording (with NumPy's).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from s2r_sim.controller.gains import RATE
from s2r_sim.robot.constants import GRAVITY, LEGS, FloatArray, Robot
from s2r_sim.robot.leg_kinematics import foot_motion
from s2r_sim.robot.rotation import rotate, turned_back
from s2r_sim.robot.signals import RobotState
from s2r_spec.compiled import compiled

Vector = tuple[float, float, float]

BLEND = 0.02
"""[s] time constant: inertial above its frequency, leg odometry below."""


class Estimate(NamedTuple):
    """Base position [m] (z above the standing feet's contact points) and velocity [m/s], world axes."""

    position: Vector
    velocity: Vector


def specific_force(rpy: Any, change: Sequence[Any], noise: Any, sin: Any, cos: Any) -> tuple[Any, Any, Any]:
    """Return the mean reading of an accelerometer over a tick [m/s²], base axes.

    ``change`` is that of the true velocity since the last tick [m/s], world
    axes, ``rpy`` the true attitude.
    """
    dx, dy, dz = change
    roll, pitch, yaw = rpy
    x, y, z = turned_back(roll, pitch, yaw, (dx * RATE, dy * RATE, dz * RATE + GRAVITY), sin, cos)
    return x + noise[0], y + noise[1], z + noise[2]


def leg_odometry(
    robot: Robot, measured: RobotState, stance: Any, sin: Any, cos: Any
) -> tuple[Any, tuple[Any, Any, Any]]:
    """Return height above the ground [m] and velocity [m/s] of the base, as the mean over standing feet.

    v = ω_shank × r ẑ − R (ω × p + ṗ), each in the world, for a foot at p in base axes. The position and the
    velocity in ``measured`` have no influence.
    """
    roll, pitch, yaw = measured.rpy
    wx, wy, wz = measured.omega
    feet = stance[0] + stance[1] + stance[2] + stance[3]
    mean = [0.0] * 9
    for i, leg in enumerate(LEGS):
        joints, weight = slice(3 * i, 3 * i + 3), stance[i] / feet
        (x, y, z), (dx, dy, dz), spin = foot_motion(
            robot, leg, measured.q[joints], measured.dq[joints], sin, cos
        )
        moved = (dx + wy * z - wz * y, dy + wz * x - wx * z, dz + wx * y - wy * x)
        mean = [total + weight * one for total, one in zip(mean, (x, y, z, *moved, *spin), strict=True)]
    _, _, foot = rotate(roll, pitch, yaw, mean[:3], sin, cos)
    ux, uy, uz = rotate(roll, pitch, yaw, mean[3:6], sin, cos)
    sx, sy, sz = mean[6:]
    spin_x, spin_y, _ = rotate(roll, pitch, yaw, (sx + wx, sy + wy, sz + wz), sin, cos)
    radius = robot.foot_radius
    return radius - foot, (radius * spin_y - ux, -radius * spin_x - uy, -uz)


def motion(
    robot: Robot, measured: RobotState, force: Sequence[Any], stance: Any, sin: Any, cos: Any
) -> tuple[Any, tuple[Any, Any, Any], tuple[Any, Any, Any]]:
    """Return the motion of the base in world axes, at one tick or at n of them.

    That is its height above the standing feet's contact points [m], its velocity by leg odometry [m/s], and its mean
    acceleration since the last tick by the IMU [m/s²].

    Args:
        robot: the robot, for its kinematics.
        measured: attitude, rates, joint angles and speeds, as numbers or as arrays of n samples.
        force: the accelerometer's reading [m/s²], base axes.
        stance: (4,) 1 for feet that stand, else 0; or (4, n).
        sin: the sine of ``math``, or NumPy's.
        cos: the cosine of the same module.
    """
    height, velocity = leg_odometry(robot, measured, stance, sin, cos)
    roll, pitch, yaw = measured.rpy
    ax, ay, az = rotate(roll, pitch, yaw, force, sin, cos)
    return height, velocity, (ax, ay, az - GRAVITY)


@compiled
def blend(before: Vector, odometry: Vector, acceleration: Vector, ticks: float, rate: float) -> Vector:
    """Return the velocity ``ticks`` control ticks later: the IMU's integral, corrected towards leg odometry.

    ``rate`` is the number of control ticks per second.
    """
    trust = min(1.0, ticks / (BLEND * rate))
    x = before[0] + acceleration[0] * ticks / rate
    y = before[1] + acceleration[1] * ticks / rate
    z = before[2] + acceleration[2] * ticks / rate
    return x + trust * (odometry[0] - x), y + trust * (odometry[1] - y), z + trust * (odometry[2] - z)


@compiled
def _blended(odometry: FloatArray, acceleration: FloatArray, rate: float) -> FloatArray:
    """Return (n, 3) velocities of n ticks from (3, n) leg odometry and (3, n) acceleration; the first is odometry."""
    velocity = odometry.T.copy()
    (ox, oy, oz), (ax, ay, az) = odometry, acceleration
    x, y, z = ox[0], oy[0], oz[0]
    for k in range(1, len(velocity)):
        x, y, z = blend((x, y, z), (ox[k], oy[k], oz[k]), (ax[k], ay[k], az[k]), 1.0, rate)
        velocity[k, 0], velocity[k, 1], velocity[k, 2] = x, y, z
    return velocity


def update(
    robot: Robot,
    before: Estimate | None,
    measured: RobotState,
    force: Vector,
    stance: Any,
    ticks: float = 1.0,
) -> Estimate:
    """Return the estimate at one tick; the first one is leg odometry alone.

    Args:
        robot: the robot, for its kinematics.
        before: the estimate ``ticks`` control ticks earlier; None at the first.
        measured: attitude, rates, joint angles and speeds; of the position, (x, y) at the first tick.
        force: the accelerometer's reading [m/s²], base axes. After missed ticks it also counts for these.
        stance: (4,) 1 for feet that stand, else 0.
        ticks: time since ``before`` on the robot's own clock, in control ticks of 2 ms.
    """
    numbers = RobotState(measured.flat.tolist())
    height, odometry, acceleration = motion(robot, numbers, force, stance, math.sin, math.cos)
    if before is None:
        return Estimate((numbers.position[0], numbers.position[1], height), odometry)
    vx, vy, vz = blend(before.velocity, odometry, acceleration, ticks, RATE)
    x, y, _ = before.position
    return Estimate((x + vx * ticks / RATE, y + vy * ticks / RATE, height), (vx, vy, vz))


def replay(robot: Robot, measured: RobotState, force: Sequence[Any], stance: Any) -> FloatArray:
    """Return (n, 3) the estimator's velocities over a recording of n ticks."""
    _, odometry, acceleration = motion(robot, measured, force, stance, np.sin, np.cos)
    return _blended(np.array(odometry), np.array(acceleration), RATE)
