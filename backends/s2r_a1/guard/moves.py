"""The guard's own motions, pure functions of time: standing up, standing, and lying down.

A motion moves the joints from one pose to another along a cubic s of time,

    q(t) = start + s(x) (target − start),   s(x) = x² (3 − 2 x),   x = (t − begun) / span, clipped to [0, 1]

so that it begins and ends at rest. Angles [rad], (12,); times [ns].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from s2r_a1.guard import leg
from s2r_a1.wire import MOTORS, FloatArray, Orders

STAND_HEIGHT = 0.28
"""A definition [m]: height of the base in a stand, as in the walking controller of ``s2r_sim``."""
STAND_UP = 2_000_000_000
"""A level [ns]: time to stand up. Source: unitree_guide."""
LIE_DOWN = 2_000_000_000
"""A level [ns]: time to lie down. Source: as for standing up."""
CATCH = 300_000_000
"""A level [ns]: time from a walk to the stand. A step of the trot takes 200 ms; a robot on two legs tips before the
other legs are down."""
YIELD = 0.25
"""A budget [rad]: largest angle beyond a joint's own at which a stand may begin, to take over the load of a walk. It
gives 15 to 20 N·m."""

KP = np.tile([60.0, 40.0, 80.0], 4)
"""Levels [N·m/rad]: position gains of hip, thigh, calf. Source: unitree_guide, on the robot."""
KD = np.tile([5.0, 4.0, 7.0], 4)
"""Levels [N·m·s/rad]: speed gains of hip, thigh, calf. Source: as for KP."""
DAMPING = 3.0
"""A level [N·m·s/rad]: speed gain of a damped robot. Source: unitree_guide."""

ZERO = np.zeros(MOTORS)
STANDING = np.tile(leg.stand_angles(leg.A1, STAND_HEIGHT), 4)
"""A definition: pose of the stand, with the feet below the hips."""
LYING = np.tile([0.0, 1.305, -2.61], 4)
"""A definition: final pose of lying down, 0.12 m high, with the calves 0.09 rad from their stops."""

LIMP = Orders(ZERO, ZERO, ZERO, ZERO, ZERO)
"""A definition: commands without gains or torques."""
DAMPED = Orders(ZERO, ZERO, ZERO, np.full(MOTORS, DAMPING), ZERO)
"""A definition: commands for a robot that must stop moving."""


class PoseMotion(NamedTuple):
    """A motion from one pose to another, in a span of time."""

    start: FloatArray
    target: FloatArray
    begun: int
    span: int


def done(motion: PoseMotion, now: int) -> bool:
    """Return whether a motion has ended."""
    return now - motion.begun >= motion.span


def desired_state(motion: PoseMotion, now: int) -> tuple[FloatArray, FloatArray]:
    """Return the reference angles and speeds of a motion now [rad, rad/s]."""
    if done(motion, now):
        return motion.target, ZERO
    x = max(now - motion.begun, 0) / motion.span
    way = motion.target - motion.start
    return motion.start + x * x * (3.0 - 2.0 * x) * way, (6.0 * x * (1.0 - x) * 1e9 / motion.span) * way


def orders(motion: PoseMotion, now: int) -> Orders:
    """Return the motor commands of a motion."""
    q, dq = desired_state(motion, now)
    return Orders(q, dq, KP, KD, ZERO)


def standing_up(q: FloatArray, now: int) -> PoseMotion:
    """Return the motion from measured angles to the stand."""
    return PoseMotion(q, STANDING, now, STAND_UP)


def catch(q: FloatArray, tau: FloatArray, now: int) -> PoseMotion:
    """Return the motion from a walk to the stand.

    It begins beyond the measured angles, so that the stand's gains give the present torques of the motors. Otherwise
    the legs would give way until the gains carry the load.
    """
    return PoseMotion(q + np.clip(tau / KP, -YIELD, YIELD), STANDING, now, CATCH)


def lying_down(q: FloatArray, now: int) -> PoseMotion:
    """Return the motion from the present reference angles to the lying pose."""
    return PoseMotion(q, LYING, now, LIE_DOWN)
