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


def base_task(
    gains: Gains, measured: State, twist: FloatArray, reference: Reference, command: Command, ground: float
) -> FloatArray:
    """Return (6, 7) the base's task (L, −L a): what a deviation costs is |(L, −L a) (a_is, 1)|².

    The wanted spatial acceleration a is proportional-derivative in the heading
    frame and in roll, pitch, yaw; L'L is the weight of a deviation from it.

    p̈ = kp (p_des − p) + kd (v_des − v), no integral. The spatial acceleration
    is R'p̈ − ω × (R'v). The weights, too, are those of the heading frame, turned
    into base axes by H = Ry(pitch) Rx(roll): the linear part of L is √w H.

    ``twist`` is (6,) in base axes; ``ground`` [m] is the
    height of the stance feet's contact points.
    """
    x, y, z = measured.position.tolist()
    vx, vy, vz = measured.velocity.tolist()
    roll, pitch, yaw = measured.rpy.tolist()
    ux, uy, uz, wx, wy, wz = twist.tolist()
    c, s = cos(yaw), sin(yaw)

    kp, kd = gains.kp_linear, gains.kd_linear
    forward = kd[0] * (command.vx - (c * vx + s * vy))
    left = kp[1] * reference.left_of(x, y) + kd[1] * (command.vy - (c * vy - s * vx))
    up = kp[2] * (gains.base_height - (z - ground)) - kd[2] * vz

    kp, kd = gains.kp_angular, gains.kd_angular
    turn = remainder(reference.yaw - yaw, 2.0 * pi)
    cr, sr, cp, sp = cos(roll), sin(roll), cos(pitch), sin(pitch)
    ax = cp * forward - sp * up - (wy * uz - wz * uy)
    ay = sp * sr * forward + cr * left + cp * sr * up - (wz * ux - wx * uz)
    az = sp * cr * forward - sr * left + cp * cr * up - (wx * uy - wy * ux)
    roll_acceleration = -kp[0] * roll - kd[0] * wx
    pitch_acceleration = -kp[1] * pitch - kd[1] * wy
    yaw_acceleration = kp[2] * turn + kd[2] * (command.wz - wz)
    a, b, d = gains.root_linear
    e, f, g = gains.root_angular
    a_cp, a_spsr, a_spcr = a * cp, a * sp * sr, a * sp * cr
    b_cr, b_sr = b * cr, b * sr
    d_sp, d_cpsr, d_cpcr = d * sp, d * cp * sr, d * cp * cr
    # fmt: off
    return np.array((
        (a_cp, a_spsr, a_spcr, 0.0, 0.0, 0.0, -a_cp * ax - a_spsr * ay - a_spcr * az),
        (0.0, b_cr, -b_sr, 0.0, 0.0, 0.0, b_sr * az - b_cr * ay),
        (-d_sp, d_cpsr, d_cpcr, 0.0, 0.0, 0.0, d_sp * ax - d_cpsr * ay - d_cpcr * az),
        (0.0, 0.0, 0.0, e, 0.0, 0.0, -e * roll_acceleration),
        (0.0, 0.0, 0.0, 0.0, f, 0.0, -f * pitch_acceleration),
        (0.0, 0.0, 0.0, 0.0, 0.0, g, -g * yaw_acceleration),
    ))
    # fmt: on
