"""Forward kinematics of one leg in closed form, for single numbers and for whole recordings."""

from __future__ import annotations

from math import acos
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_sim.robot.constants import LEGS, Leg, Robot


class FootMotion(NamedTuple):
    """In base axes, each (x, y, z): ball centre [m], its velocity [m/s], the shank's angular velocity [rad/s].

    Both velocities are relative to the base.
    """

    position: tuple[Any, Any, Any]
    velocity: tuple[Any, Any, Any]
    spin: tuple[Any, Any, Any]


def foot_motion(robot: Robot, leg: Leg, q: Any, dq: Any, sin: Any, cos: Any) -> FootMotion:
    """Return the motion of a leg's foot.

    ``q`` and ``dq`` are its hip, thigh and calf angles [rad] and speeds
    [rad/s]; ``sin`` and ``cos`` those of ``math`` for numbers, numpy's for arrays.
    """
    hip, thigh, knee = q[0], q[1], q[1] + q[2]
    d_hip, d_thigh, d_knee = dq[0], dq[1], dq[1] + dq[2]
    upper, lower = robot.thigh_length, robot.calf_length
    # In the plane of the leg, before the roll of the hip, relative to the thigh joint.
    s, c, s_knee, c_knee = sin(thigh), cos(thigh), sin(knee), cos(knee)
    x = -upper * s - lower * s_knee
    z = -upper * c - lower * c_knee
    dx = -upper * c * d_thigh - lower * c_knee * d_knee
    dz = upper * s * d_thigh + lower * s_knee * d_knee
    out = leg.sy * robot.thigh_y
    c, s = cos(hip), sin(hip)
    y, z, dy, dz = c * out - s * z, s * out + c * z, -s * dz, c * dz
    return FootMotion(
        (leg.sx * robot.hip_x + x, leg.sy * robot.hip_y + y, z),
        (dx, dy - z * d_hip, dz + y * d_hip),
        (d_hip, c * d_knee, s * d_knee),
    )


def stand_angles(robot: Robot, height: float) -> NDArray[np.float64]:
    """Return (12,) joint angles of a stand of this base height [m], feet below the hips."""
    knee = acos((height - robot.foot_radius) / (robot.thigh_length + robot.calf_length))
    return np.tile([0.0, knee, -2.0 * knee], len(LEGS))
