"""Signals between the robot and its controller: state, motor command, commanded velocity."""

from __future__ import annotations

from typing import NamedTuple

from s2r_sim.robot.constants import FloatArray


class RobotState:
    """A state of the robot, true or measured: one vector, and its parts as views of it.

    Attributes:
        flat: (36,) everything below, in this order.
        position: (3,) base origin in the world [m].
        rpy: (3,) roll, pitch, yaw of the base [rad], rotation Rz(yaw) Ry(pitch) Rx(roll).
        velocity: (3,) of the base origin, world axes [m/s].
        omega: (3,) angular velocity, base axes [rad/s].
        q: (12,) joint angles [rad].
        dq: (12,) joint speeds [rad/s].
    """

    __slots__ = ("dq", "flat", "omega", "position", "q", "rpy", "velocity")

    def __init__(self, flat: FloatArray) -> None:
        self.flat = flat
        self.position = flat[0:3]
        self.rpy = flat[3:6]
        self.velocity = flat[6:9]
        self.omega = flat[9:12]
        self.q = flat[12:24]
        self.dq = flat[24:36]


class MotorCommand(NamedTuple):
    """τ_ff + Kp (q_des − q) + Kd (q̇_des − q̇) for the twelve motors, each (12,)."""

    q: FloatArray
    dq: FloatArray
    kp: FloatArray
    kd: FloatArray
    tau: FloatArray


class VelocityCommand(NamedTuple):
    """Commanded velocity in the heading frame: forward and left [m/s], yaw rate [rad/s]."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0
