"""The base task: where the trunk should accelerate to follow the commanded velocity."""

from __future__ import annotations

from math import cos, pi, remainder, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_sim.gains import RATE, Gains
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]


class Command(NamedTuple):
    """Commanded velocity in the heading frame: forward and left [m/s], yaw rate [rad/s]."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0


class Reference(NamedTuple):
    """Where the base should be: (x, y) [m] and yaw [rad] in the world.

    Along the heading it is tied to the robot, since only speed is commanded
    there; across the heading it moves with the command.
    """

    x: float
    y: float
    yaw: float

    def advanced(self, measured: State, command: Command) -> Reference:
        """Return the reference one tick later."""
        x, y, _ = measured.position.tolist()
        across = self.left_of(x, y) + command.vy / RATE
        yaw = self.yaw + command.wz / RATE
        return Reference(x - across * sin(yaw), y + across * cos(yaw), yaw)

    def left_of(self, x: float, y: float) -> float:
        """Return how far the reference lies to the left of a point [m]."""
        return -sin(self.yaw) * (self.x - x) + cos(self.yaw) * (self.y - y)


def base_acceleration(
    gains: Gains,
    measured: State,
    rotation: FloatArray,
    reference: Reference,
    command: Command,
    ground: float,
) -> FloatArray:
    """Return (6,) the wanted spatial acceleration of the base in base axes.

    Proportional-derivative in the heading frame and in roll, pitch, yaw:
    p̈ = kp (p_des − p) + kd (v_des − v), no integral. The spatial acceleration
    is R'p̈ − ω × (R'v).

    ``rotation`` (3, 3) takes base axes to world axes; ``ground`` [m] is the
    height of the stance feet's contact points.
    """
    x, y, z = measured.position.tolist()
    vx, vy, vz = measured.velocity.tolist()
    roll, pitch, yaw = measured.rpy.tolist()
    wx, wy, wz = measured.omega.tolist()
    c, s = cos(yaw), sin(yaw)

    kp, kd = gains.kp_linear, gains.kd_linear
    forward = kd[0] * (command.vx - (c * vx + s * vy))
    left = kp[1] * reference.left_of(x, y) + kd[1] * (command.vy - (c * vy - s * vx))
    up = kp[2] * (gains.base_height - (z - ground)) - kd[2] * vz

    kp, kd = gains.kp_angular, gains.kd_angular
    turn = remainder(reference.yaw - yaw, 2.0 * pi)
    wanted = (
        np.array([c * forward - s * left, s * forward + c * left, up, vx, vy, vz]).reshape(2, 3) @ rotation
    )
    ax, ay, az = wanted[0].tolist()
    ux, uy, uz = wanted[1].tolist()
    return np.array(
        [
            ax - (wy * uz - wz * uy),
            ay - (wz * ux - wx * uz),
            az - (wx * uy - wy * ux),
            -kp[0] * roll - kd[0] * wx,
            -kp[1] * pitch - kd[1] * wy,
            kp[2] * turn + kd[2] * (command.wz - wz),
        ]
    )


def base_weight(gains: Gains, rotation: FloatArray, yaw: float) -> FloatArray:
    """Return (6, 6) the weight of a deviation: heading-frame weights turned into base axes."""
    c, s = cos(yaw), sin(yaw)
    heading = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation
    weight = np.zeros((6, 6))
    weight[:3, :3] = heading.T @ (np.array(gains.weight_linear)[:, None] * heading)
    weight.flat[21::7] = gains.weight_angular
    return weight
