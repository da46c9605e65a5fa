"""Signals between the robot and its controller: state, motor command, commanded velocity."""

from __future__ import annotations

from typing import NamedTuple

from s2r_sim.robot.constants import FloatArray


class RobotState:
    """A state of the robot, true or measured: one vector ``flat`` (36,), and its parts in order as views of it."""

    __slots__ = ("flat",)

    def __init__(self, flat: FloatArray) -> None:
        self.flat = flat

    @property
    def position(self) -> FloatArray:
        """(3,) base origin in the world [m]."""
        return self.flat[0:3]

    @property
    def rpy(self) -> FloatArray:
        """(3,) roll, pitch, yaw of the base [rad], rotation Rz(yaw) Ry(pitch) Rx(roll)."""
        return self.flat[3:6]

    @property
    def velocity(self) -> FloatArray:
        """(3,) of the base origin, world axes [m/s]."""
        return self.flat[6:9]

    @property
    def omega(self) -> FloatArray:
        """(3,) angular velocity, base axes [rad/s]."""
        return self.flat[9:12]

    @property
    def q(self) -> FloatArray:
        """(12,) joint angles [rad]."""
        return self.flat[12:24]

    @property
    def dq(self) -> FloatArray:
        """(12,) joint speeds [rad/s]."""
        return self.flat[24:36]


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
