"""Compute the positions of the feet and the height of the base, in plain Python numbers.

Data: joint angles q and the attitude of the base as a unit quaternion (w, x, y, z). The guard has its own kinematics
because it must not load a simulator; ``tests/a1/test_limits.py`` compares them with ``s2r_sim``. Legs in the
order FR, FL, RR, RL; axes x forward, y left, z up; m and rad.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import acos, cos, sin


@dataclass(frozen=True)
class Legs:
    """Lengths [m] of a quadruped's legs. Source of the defaults: the A1's URDF, as in ``s2r_sim.robot.constants``.

    Attributes:
        hip_x, hip_y: position of the hip joints from the middle of the base.
        thigh_y: distance of the thigh joint outwards from the hip joint.
        thigh, calf: from thigh joint to knee, and from the knee to the centre of the foot.
        foot: radius of the spherical foot.
    """

    hip_x: float = 0.1805
    hip_y: float = 0.047
    thigh_y: float = 0.0838
    thigh: float = 0.2
    calf: float = 0.2
    foot: float = 0.02


A1 = Legs()
SIDES = ((1, -1), (1, 1), (-1, -1), (-1, 1))
"""A definition: (+1 front or −1 rear, +1 left or −1 right) of each leg."""


def feet(legs: Legs, q: Sequence[float]) -> Iterator[tuple[float, float, float]]:
    """Yield the centres of the four feet in base axes [m], from twelve joint angles [rad]."""
    for leg, (front, left) in enumerate(SIDES):
        hip, thigh, calf = q[3 * leg], q[3 * leg + 1], q[3 * leg + 2]
        x = -legs.thigh * sin(thigh) - legs.calf * sin(thigh + calf)
        down = legs.thigh * cos(thigh) + legs.calf * cos(thigh + calf)
        out = left * legs.thigh_y
        c, s = cos(hip), sin(hip)
        yield front * legs.hip_x + x, left * legs.hip_y + c * out + s * down, s * out - c * down


def heights(legs: Legs, q: Sequence[float], quaternion: Sequence[float]) -> Iterator[float]:
    """Yield the height [m] of the base above a level ground through each foot; it is largest for the lowest foot."""
    w, a, b, c = quaternion
    up = (2.0 * (a * c - w * b), 2.0 * (b * c + w * a), 1.0 - 2.0 * (a * a + b * b))
    for x, y, z in feet(legs, q):
        yield legs.foot - (up[0] * x + up[1] * y + up[2] * z)


def stand_angles(legs: Legs, height: float) -> tuple[float, float, float]:
    """Return the hip, thigh and calf angles [rad] of a stand: the base at this height [m], the feet below the hips.

    Thigh and calf must have equal lengths.
    """
    thigh = acos((height - legs.foot) / (legs.thigh + legs.calf))
    return 0.0, thigh, -2.0 * thigh
