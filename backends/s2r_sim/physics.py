"""What the plant assumes about contact, joints and integration, in one table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Physics:
    """Options of the nominal plant.

    ``timestep`` [s]; ``friction`` and ``torsion`` [m] of foot on ground;
    ``solref`` (time constant [s], damping ratio) and ``solimp`` of the contact
    as MuJoCo defines them; ``armature`` [kg m²], ``damping`` [N m s/rad] and
    ``dry_friction`` [N m] of every joint.
    """

    timestep: float = 0.001
    iterations: int = 20
    friction: float = 0.8
    torsion: float = 0.01
    impratio: float = 10.0
    solref: tuple[float, float] = (0.008, 1.0)
    solimp: tuple[float, float, float] = (0.9, 0.95, 0.001)
    armature: float = 0.005
    damping: float = 0.05
    dry_friction: float = 0.1


@dataclass(frozen=True)
class FallLimits:
    """Beyond these the robot has fallen: lowest base height [m], largest tilt of its z axis [rad]."""

    height: float = 0.16
    tilt: float = 0.7


class State:
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
