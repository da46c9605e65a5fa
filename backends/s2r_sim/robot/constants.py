"""The robot: all inertial and kinematic constants of the Unitree A1.

Source: ``a1_description/urdf/a1.urdf`` in the registry package
``example-robot-data`` 6.0.0 (13.741 kg with a trunk of 6.0 kg). Newer vendor files
have a trunk of 4.713 kg; the right mass of a given robot is an open question.
``tests/sim/test_constants.py`` compares this table with that file. Both the MuJoCo
and the Pinocchio model are built from the table.

Legs are always in the order FR, FL, RR, RL; joints of a leg hip, thigh, calf.
Axes: x forward, y left, z up. SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Vector3 = tuple[float, float, float]

GRAVITY = 9.81
"""[m/s²]"""


@dataclass(frozen=True)
class Inertia:
    """Mass [kg], centre of mass in the link frame [m], tensor about it [kg m²]."""

    mass: float
    com: Vector3
    xx: float
    yy: float
    zz: float
    xy: float = 0.0
    xz: float = 0.0
    yz: float = 0.0

    @property
    def tensor(self) -> FloatArray:
        """(3, 3) rotational inertia about the centre of mass, axes of the link frame."""
        return np.array(
            [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]]
        )

    def mirrored(self, sx: int, sy: int) -> Inertia:
        """Return the inertia of the link mirrored in x (``sx = -1``) and in y (``sy = -1``)."""
        x, y, z = self.com
        products = {"xy": sx * sy * self.xy, "xz": sx * self.xz, "yz": sy * self.yz}
        return replace(self, com=(sx * x, sy * y, z), **products)


def fuse(parts: Sequence[tuple[Inertia, Vector3]]) -> Inertia:
    """Return the inertia of rigidly joined links, each with the offset of its frame (Steiner)."""
    mass = sum(part.mass for part, _ in parts)
    coms = [np.add(part.com, offset) for part, offset in parts]
    com = np.average(coms, axis=0, weights=[part.mass for part, _ in parts])
    tensor = np.zeros((3, 3))
    for (part, _), at in zip(parts, coms, strict=True):
        d = at - com
        tensor += part.tensor + part.mass * (d @ d * np.eye(3) - np.outer(d, d))
    x, y, z = com.tolist()
    return Inertia(
        mass, (x, y, z), tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]
    )


class Leg(NamedTuple):
    """Name and side of a leg: ``sx`` +1 front, −1 rear; ``sy`` +1 left, −1 right."""

    name: str
    sx: int
    sy: int


LEGS = (Leg("FR", 1, -1), Leg("FL", 1, 1), Leg("RR", -1, -1), Leg("RL", -1, 1))
JOINTS = tuple(f"{leg.name}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf"))


@dataclass(frozen=True)
class Robot:
    """The A1. Link inertias are those of the front left leg; the other legs mirror them."""

    trunk: Inertia = Inertia(
        6.0, (0.0, 0.0041, -0.0005), 0.0158533, 0.0377999, 0.0456542, -3.66e-05, -6.11e-05, -2.75e-05
    )
    imu: Inertia = Inertia(0.001, (0.0, 0.0, 0.0), 1e-4, 1e-4, 1e-4)
    hip: Inertia = Inertia(
        0.696, (-0.003311, 0.000635, 3.1e-05), 0.000469246, 0.00080749, 0.000552929, -9.409e-06, -3.42e-07, -4.66e-07,
    )  # fmt: skip
    thigh: Inertia = Inertia(
        1.013, (-0.003237, -0.022327, -0.027326),
        0.005529065, 0.005139339, 0.001367788, 4.825e-06, 0.000343869, 2.2448e-05,
    )  # fmt: skip
    calf: Inertia = Inertia(
        0.166, (0.006435, 0.0, -0.107388), 0.002997972, 0.003014022, 3.2426e-05, 0.0, -0.000141163, 0.0
    )
    foot: Inertia = Inertia(0.06, (0.0, 0.0, 0.0), 9.6e-06, 9.6e-06, 9.6e-06)

    hip_x: float = 0.1805
    hip_y: float = 0.047
    thigh_y: float = 0.0838
    thigh_length: float = 0.2
    calf_length: float = 0.2
    foot_radius: float = 0.02
    trunk_box: Vector3 = (0.267, 0.194, 0.114)

    limits: tuple[tuple[float, float], ...] = (
        (-0.8028514559173915, 0.8028514559173915),
        (-1.0471975511965976, 4.1887902047863905),
        (-2.6965336943312392, -0.9162978572970231),
    )
    """[rad] lowest and highest angle of hip, thigh and calf."""
    torque_limit: float = 33.5
    speed_limit: float = 21.0

    def loaded(self, payloads: Sequence[tuple[float, Vector3]], com_shift: Vector3) -> Robot:
        """Return the robot with point masses [kg] at (x, y, z) [m] on the trunk, and its centre of mass moved."""
        (x, y, z), (dx, dy, dz) = self.trunk.com, com_shift
        trunk = replace(self.trunk, com=(x + dx, y + dy, z + dz))
        for mass, at in payloads:
            trunk = fuse([(trunk, (0.0, 0.0, 0.0)), (Inertia(mass, at, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))])
        return replace(self, trunk=trunk)

    @property
    def base(self) -> Inertia:
        """Trunk and IMU in one body."""
        return fuse([(self.trunk, (0.0, 0.0, 0.0)), (self.imu, (0.0, 0.0, 0.0))])

    @property
    def shank(self) -> Inertia:
        """Calf and foot in one body, in the calf frame."""
        return fuse([(self.calf, (0.0, 0.0, 0.0)), (self.foot, self.foot_offset)])

    @property
    def foot_offset(self) -> Vector3:
        """Centre of the ball foot in the calf frame [m]."""
        return (0.0, 0.0, -self.calf_length)

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return self.base.mass + len(LEGS) * (self.hip.mass + self.thigh.mass + self.shank.mass)

    def links(self, leg: Leg) -> tuple[tuple[str, Inertia, Vector3], ...]:
        """Return (name, inertia, joint placement in the parent [m]) of a leg's hip, thigh and calf."""
        return (
            ("hip", self.hip.mirrored(leg.sx, leg.sy), (leg.sx * self.hip_x, leg.sy * self.hip_y, 0.0)),
            ("thigh", self.thigh.mirrored(1, leg.sy), (0.0, leg.sy * self.thigh_y, 0.0)),
            ("calf", self.shank.mirrored(1, leg.sy), (0.0, 0.0, -self.thigh_length)),
        )


A1 = Robot()
