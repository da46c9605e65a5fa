"""The constants of the guard's checks in one table, and the words that name the cause of a stopped rollout.

Words of the robot, which count as outcomes: fall, joint, torque, power, heat, motor. Words of other causes, which make
a rollout void: link, client, operator, disk.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import cos, sin, sqrt
from typing import Literal, NamedTuple, TypeVar, get_args

import numpy as np

from s2r_a1.guard import leg
from s2r_a1.wire import KD, KP, MOTORS, TAU, FloatArray

T = TypeVar("T")
Vector3 = tuple[float, float, float]

RobotWord = Literal["fall", "joint", "torque", "power", "heat", "motor"]
VoidWord = Literal["link", "client", "operator", "disk"]
Word = Literal[RobotWord, VoidWord]
ROBOT_WORDS: frozenset[str] = frozenset(get_args(RobotWord))
"""A definition: words of a rollout that the robot itself ended; it counts with the spec's value for a fall."""
VOID_WORDS: frozenset[str] = frozenset(get_args(VoidWord))
"""A definition: words of a rollout that another cause ended; it is kept, and its test runs again."""

MS = 1_000_000
"""A definition: nanoseconds of a millisecond; all times of the guard are whole nanoseconds."""
SECOND = 1000 * MS
"""A definition: nanoseconds of a second."""
ROUND = 2 * MS
"""A definition: nanoseconds of a round, the time between two commands."""


class Figure(NamedTuple):
    """The unit and the source of a constant, and the effect of doubling it."""

    unit: str
    source: str
    twice: str


def _level(value: T, unit: str, source: str, twice: str) -> T:
    """Declare a constant of :class:`Limits` with its :class:`Figure`."""
    return field(default=value, metadata={"figure": Figure(unit, source, twice)})


_STOPS = Figure("rad", "Safety of SDK for the A1: hip, thigh, calf", "legs may strike their stops")


@dataclass(frozen=True)
class Limits:
    """Every constant of the guard's checks, for the A1; all are levels except the first three, which define the robot.

    The metadata of each field have its ``figure``.
    Sources by their short names: SDK = unitree_legged_sdk, FE = fast_and_efficient, WP = walk_in_the_park,
    QP = A1-QP-MPC-Controller, guide = unitree_guide, ZZ = ros_udp_node of Z. Zhuang.
    """

    lowest: Vector3 = field(default=(-0.802, -1.05, -2.7), metadata={"figure": _STOPS})
    highest: Vector3 = field(default=(0.802, 4.19, -0.916), metadata={"figure": _STOPS})
    legs: leg.Legs = field(
        default=leg.A1,
        metadata={"figure": Figure("m", "the A1's URDF", "the height is off by the same amount")},
    )
    margin: float = _level(
        0.087,
        "rad",
        "PositionProtect of SDK; standing and walking joints keep it",
        "crouched walks end as faults",
    )
    torque: float = _level(
        33.5, "N·m", "the A1's URDF; ZZ stops beyond it, WP beyond 35.5", "overloaded gears go unnoticed"
    )
    torque_rounds: int = _level(
        3, "rounds", "one reading may be wrong, and an impact lasts one", "an overload lasts 6 ms longer"
    )
    strain: float = _level(
        20.0, "N·m", "a motor held at 24.5 N·m failed at 48 °C (SDK issue 54)", "no warning"
    )
    strain_time: int = _level(
        SECOND, "ns", "a step of the trot takes 0.2 s", "the warning comes a second later"
    )
    power_level: int = _level(
        5,
        "1 to 10",
        "PowerProtect of SDK: 1 for the new, 5 usual, 8 to 10 for walking fast",
        "1000 W are allowed",
    )
    power_rounds: int = _level(
        6,
        "rounds",
        "PowerProtect of SDK ends its process at the sixth round",
        "an overload lasts 12 ms longer",
    )
    hot: float = _level(
        60.0, "°C", "motors of an A1 stop themselves within minutes (WP warns at 50)", "a limp leg"
    )
    warm: float = _level(
        50.0, "°C", "WP warns there; no test begins above it", "heat ends tests, and they are lost"
    )
    tilt: float = _level(
        0.5, "rad", "FE stops at 0.555; a specification's fall is 0.7", "falls end in an impact"
    )
    height: float = _level(
        0.18, "m", "FE uses it, too; a specification's fall is 0.16", "a stand of 0.28 m counts as a fall"
    )
    deviation: float = _level(
        0.5,
        "rad",
        "a pose out of reach burnt a motor (locomotion_simulation issue 7)",
        "the position gain commands 2 × 40 N·m",
    )
    still: float = _level(0.05, "rad/s", "a robot that walks by itself moves faster", "a slow walk is armed")
    still_time: int = _level(
        SECOND // 2,
        "ns",
        "a period of the trot is 0.4 s, and the encoders' noise is 1 mrad",
        "arming takes 0.5 s more",
    )
    bridged: int = _level(
        10 * MS,
        "ns",
        "ZZ; gaps on loopback are 7 ms at most (benchmarks/a1/gaps.py)",
        "torque acts on old states",
    )
    silence: int = _level(
        20 * MS, "ns", "ZZ: 20 to 50 ms; the robot's own limit is 30 ms", "the robot's own rule acts first"
    )
    absence: int = _level(
        SECOND,
        "ns",
        "only in states without motion; changing a battery takes longer",
        "a robot that was switched off and on stays armed",
    )
    dropped: int = _level(5, "packets", "five rounds are 10 ms", "torque acts on old states")
    kp: float = _level(100.0, "N·m/rad", "the stiffest stand published (FE, WP)", "joints ring")
    kd: float = _level(10.0, "N·m·s/rad", "the guide's stand has 7", "joints ring")
    speed: float = _level(21.0, "rad/s", "the A1's URDF", "kd alone commands 200 N·m")
    wild_speed: float = _level(
        42.0, "rad/s", "twice the joints' largest speed", "a broken encoder acts for longer"
    )
    wild_angle: float = _level(
        0.5,
        "rad",
        "beyond a joint's stop; a calf rests 0.1 beyond (SDK issue 131)",
        "a broken encoder acts for longer",
    )
    wild_turn: float = _level(
        35.0, "rad/s", "range of gyros of this kind, 2000 °/s", "a broken IMU acts for longer"
    )
    cold: float = _level(
        -40.0, "°C", "range of sensors and batteries of this kind", "a broken sensor hides a motor's heat"
    )
    norm: float = _level(0.05, "1", "an attitude's quaternion has the norm 1", "a broken IMU acts for longer")

    @cached_property
    def span(self) -> tuple[FloatArray, FloatArray]:
        """(12,) lowest and highest angle [rad] of every joint."""
        return np.tile(self.lowest, 4), np.tile(self.highest, 4)

    @cached_property
    def kept(self) -> tuple[FloatArray, FloatArray]:
        """(12,) middle [rad] and inverse half width of the allowed joint angles in a stand or a walk."""
        return self._narrowed(self.margin)

    @cached_property
    def possible(self) -> tuple[FloatArray, FloatArray]:
        """(12,) middle [rad] and inverse half width of the possible joint angles."""
        return self._narrowed(-self.wild_angle)

    @cached_property
    def ordered(self) -> tuple[FloatArray, FloatArray]:
        """(60,) smallest and largest numbers of commands that need no clipping."""
        (low, high), one = self.span, np.ones(MOTORS)
        least = (low, -self.speed * one, 0.0 * one, 0.0 * one, -self.torque * one)
        most = (high, self.speed * one, self.kp * one, self.kd * one, self.torque * one)
        return np.concatenate(least), np.concatenate(most)

    @cached_property
    def allowed(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """(60,) the same for a packet's q, dq, tau, kp and kd, in its own counts."""
        least, most = (np.split(numbers, 5) for numbers in self.ordered)
        return _packed(*least), _packed(*most)

    @cached_property
    def calm(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """(58,) smallest and largest numbers, from quaternion to temperature, of a reading far from every limit."""
        (low, high), one = self.span, np.ones(MOTORS)
        tau, unit = min(self.strain, self.torque), 1.0 + self.norm
        most = (
            [unit, self.lean, self.lean, unit],
            [self.wild_turn] * 3,
            [np.finfo(float).max] * 3,
            high - self.margin,
            self.wild_speed * one,
            tau * one,
            np.nextafter(min(self.warm, self.hot), 0.0) * one,
        )
        least = (
            *(-np.array(row) for row in most[:3]),
            low + self.margin,
            -most[4],
            -most[5],
            self.cold * one,
        )
        return tuple(np.concatenate(least).tolist()), tuple(np.concatenate(most).tolist())

    @cached_property
    def lean(self) -> float:
        """Largest quaternion components x and y of a base that tilts about both axes within the limit."""
        return sin(self.tilt / 2.0) / sqrt(2.0)

    @cached_property
    def upright(self) -> float:
        """Smallest allowed cosine of the angle between the base's z axis and the vertical."""
        return cos(self.tilt)

    @property
    def watts(self) -> float:
        """Power that the level allows [W]."""
        return 100.0 * min(max(self.power_level, 1), 10)

    def _narrowed(self, margin: float) -> tuple[FloatArray, FloatArray]:
        low, high = self.span
        return (low + high) / 2.0, 2.0 / (high - low - 2.0 * margin)


def _packed(
    q: FloatArray, dq: FloatArray, kp: FloatArray, kd: FloatArray, tau: FloatArray
) -> tuple[float, ...]:
    return tuple(np.concatenate((q, dq, tau * TAU, kp * KP, kd * KD)).tolist())


LIMITS = Limits()
"""Limits of the A1."""
