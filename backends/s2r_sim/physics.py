"""What the plant assumes about contact, joints and integration, in one table."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class State:
    """A state of the robot, true or measured.

    Attributes:
        position: (3,) base origin in the world [m].
        rpy: (3,) roll, pitch, yaw of the base [rad], rotation Rz(yaw) Ry(pitch) Rx(roll).
        velocity: (3,) of the base origin, world axes [m/s].
        omega: (3,) angular velocity, base axes [rad/s].
        q: (12,) joint angles [rad].
        dq: (12,) joint speeds [rad/s].
    """

    position: FloatArray
    rpy: FloatArray
    velocity: FloatArray
    omega: FloatArray
    q: FloatArray
    dq: FloatArray


@dataclass(frozen=True, eq=False)
class MotorCommand:
    """τ_ff + Kp (q_des − q) + Kd (q̇_des − q̇) for the twelve motors, each (12,)."""

    q: FloatArray
    dq: FloatArray
    kp: FloatArray
    kd: FloatArray
    tau: FloatArray
