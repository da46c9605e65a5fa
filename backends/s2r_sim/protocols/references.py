"""The A1's protocols and their joint references: a pure function of name, amplitude and gain.

Every joint runs τ = Kp (q_des − q) + Kd (q̇_des − q̇). The references begin at rest: the first pose is held while the
robot settles, and amplitudes grow over the first 0.2 to 0.4 s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from s2r_sim.controller.gains import RATE
from s2r_sim.robot.constants import A1, LEGS, FloatArray
from s2r_spec.backend import Parameter
from s2r_spec.protocols import Protocol

SIDES = np.array([float(leg.sy) for leg in LEGS])
"""(4,) −1 for a right leg, 1 for a left one."""


@dataclass(frozen=True)
class Reference:
    """References of a protocol at every control tick.

    Attributes:
        q: (n, 12) joint angles [rad].
        dq: (n, 12) joint speeds [rad/s], the derivative of ``q``; 0 where the motors are off.
        kp: (n,) stiffness [N m/rad].
        kd: (n,) damping [N m s/rad].
        height: height of the base origin at the start [m].
        held: whether the base is held there.
    """

    q: FloatArray
    dq: FloatArray
    kp: FloatArray
    kd: FloatArray
    height: float
    held: bool


@dataclass(frozen=True)
class _Motion:
    """A motion: its pose over times [s] for an amplitude, gains, duration, where the base is, words and risk."""

    pose: Callable[[FloatArray, float], FloatArray]
    kp: float
    kd: float
    duration: float
    height: float
    held: bool
    words: str
    risk: str = ""
    off: float = np.inf
    """[s] when the motors are switched off."""


def reference(name: str, amplitude: float = 1.0, gain: float = 1.0) -> Reference:
    """Return the references of a protocol."""
    motion = MOTIONS[name]
    times = np.arange(round(motion.duration * RATE) + 1) / RATE
    q = motion.pose(times, amplitude)
    on = times < motion.off
    dq = np.where(on[:, None], np.gradient(q, 1 / RATE, axis=0), 0.0)
    kp, kd = np.where(on, gain * motion.kp, 0.0), np.where(on, np.sqrt(gain) * motion.kd, 0.0)
    return Reference(q, dq, kp, kd, motion.height, motion.held)


def ramp(times: FloatArray, seconds: float) -> FloatArray:
    """Return a smooth step from 0 to 1, of this duration [s]."""
    share = np.clip(times / seconds, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def leg(x: FloatArray | float, z: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Return thigh and calf angle [rad] for a foot at x ahead of and z below the thigh joint [m]."""
    length = A1.thigh_length
    knee = np.arccos(np.minimum(np.hypot(x, z), 1.9995 * length) / (2.0 * length))
    return knee - np.arctan2(x, z), -2.0 * knee


def _same_on_all_legs(
    hip: FloatArray | float, thigh: FloatArray | float, calf: FloatArray | float, n: int
) -> FloatArray:
    joints = np.stack([np.broadcast_to(angle, n) for angle in (hip, thigh, calf)], axis=1)
    return np.tile(joints, (1, len(LEGS)))


def _air_sine(times: FloatArray, amplitude: float) -> FloatArray:
    q = _same_on_all_legs(0.0, 0.8, -1.6, times.size)
    grown = amplitude * ramp(times, 0.2)
    for number in range(q.shape[1]):
        side, joint = divmod(number, 3)
        slow, fast = (1.3, 1.7, 2.3)[joint] + 0.1 * side, 6.1 + 0.7 * joint + 0.3 * side
        wide, narrow = (0.25, 0.35, 0.4)[joint], (0.05, 0.08, 0.1)[joint]
        q[:, number] += grown * (
            wide * np.sin(2 * pi * slow * times + side) + narrow * np.sin(2 * pi * fast * times)
        )
    return q


def _air_coast(times: FloatArray, amplitude: float) -> FloatArray:
    out = amplitude * ramp(times, 0.4)
    return _same_on_all_legs(0.35 * out, 0.8 + 0.6 * out, -1.6 - 0.5 * out, times.size)


def _air_low(times: FloatArray, amplitude: float) -> FloatArray:
    q = _same_on_all_legs(0.0, *leg(0.0, 0.25), times.size)
    for side in range(len(LEGS)):
        x = 0.1 * amplitude * ramp(times, 0.2) * np.sin(2 * pi * (1.5 + 0.2 * side) * times)
        q[:, 3 * side + 1], q[:, 3 * side + 2] = leg(x, 0.25)
    return q


def _squat(times: FloatArray, amplitude: float) -> FloatArray:
    down = 0.26 - 0.035 * amplitude * ramp(times, 0.3) * np.sin(2 * pi * 1.1 * times)
    return _same_on_all_legs(0.0, *leg(0.0, down), times.size)


def _sway(times: FloatArray, amplitude: float) -> FloatArray:
    grown = amplitude * ramp(times, 0.3)
    ahead, aside = 0.045 * grown * np.sin(2 * pi * 0.9 * times), 0.12 * grown * np.sin(2 * pi * 1.3 * times)
    return _same_on_all_legs(aside, *leg(ahead, 0.26), times.size)


def _squeeze(times: FloatArray, amplitude: float) -> FloatArray:
    q = _same_on_all_legs(0.0, *leg(0.0, 0.26), times.size)
    q[:, 0::3] += 0.5 * amplitude * ramp(times - 0.3, 1.4)[:, None] * SIDES
    return q


def _hold(times: FloatArray, amplitude: float) -> FloatArray:
    return _same_on_all_legs(0.0, *leg(0.0, 0.26 - 0.06 * amplitude * ramp(times, 0.4)), times.size)


STAND = 0.285
"""[m] height of the base from which it settles onto straight-down legs of 0.26 m, with the foot's radius."""

_HELD = "The base is held above the ground, so that no foot touches it."
_SLIPS = "feet slip and may wear; the gears take sudden loads"
MOTIONS = {
    "air_sine": _Motion(_air_sine, 25.0, 0.6, 2.0, 0.6, True, f"{_HELD} Every joint follows two sines of 1.3 to 8 Hz."),
    "air_coast": _Motion(_air_coast, 40.0, 1.0, 0.9, 0.6, True,
                         f"{_HELD} The legs move out; after 0.6 s the motors are off.", "the legs drop", off=0.6),
    "air_low": _Motion(_air_low, 40.0, 0.8, 1.6, 0.3, True,
                       "The base is held so low that the feet swing 3 cm above the ground, each at its own rate.",
                       "a foot may touch an uneven ground"),
    "squat": _Motion(_squat, 120.0, 3.0, 2.0, STAND, False,
                     "The robot stands and moves its base up and down by 35 mm."),
    "sway": _Motion(_sway, 120.0, 3.0, 2.0, STAND, False,
                    "The robot stands and moves its base forward by 45 mm and its hips to the side."),
    "squeeze": _Motion(_squeeze, 60.0, 3.0, 1.9, STAND, False,
                       "The robot stands and pushes its hips outward until the feet slip.", _SLIPS),
    "hold": _Motion(_hold, 120.0, 3.0, 10.0, STAND, False,
                    "The robot stands low for ten seconds, so that its motors carry load.", "the motors get warm"),
}  # fmt: skip
"""Protocol → its motion, in the order of a campaign: those in the air first. Amplitudes and rates are those of the
first experiment (docs/explanation)."""
AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "amplitude, as a share of the full one")
GAIN = Parameter(
    "gain", "", 0.5, 2.0, 1.0, "factor on the stiffness of the joints; damping follows its square root"
)
_COST = 0.08
"""[s] time of one core per simulated second, measured on a 2-core cloud machine."""
PROTOCOLS = tuple(
    Protocol(
        name=name,
        words=motion.words,
        place="air" if motion.held else "ground",
        duration=motion.duration,
        cost=_COST * motion.duration,
        risk=motion.risk,
        parameters=(AMPLITUDE, GAIN),
    )
    for name, motion in MOTIONS.items()
)
