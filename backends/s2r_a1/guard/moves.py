"""Makes the guard's own motions: standing up, standing, and lying down; pure functions of time.

A motion leads the joints from one pose to another along a cubic s of time,

    q(t) = start + s(x) (target − start),   s(x) = x² (3 − 2 x),   x = (t − begun) / span, kept to [0, 1]

so that it begins and ends at rest. Angles [rad], (12,); times [ns].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1.guard import leg
from s2r_a1.wire import MOTORS, Orders

FloatArray = NDArray[np.float64]

STAND_HEIGHT = 0.28
"""A definition [m]: of the base over the ground in a stand; the walking controller of ``s2r_sim`` has the same."""
STAND_UP = 2_000_000_000
"""A level [ns]: time of standing up. Source: unitree_guide. Twice as long heats motors longer."""
LIE_DOWN = 2_000_000_000
"""A level [ns]: time of lying down. Source: as of standing up. Twice as long heats the motors longer."""
CATCH = 300_000_000
"""A level [ns]: time in which a robot that walked comes to the stand. A step of the trot takes 200 ms; in twice as
long, a robot on two legs tips further before the others are down."""
YIELD = 0.25
"""A budget [rad]: how far beyond a joint's angle a stand may begin to push, so that it takes over the load of a walk.
15 to 20 N·m; twice as much is more than the motors make."""

KP = np.tile([60.0, 40.0, 80.0], 4)
"""Levels [N·m/rad] of hip, thigh, calf. Source: unitree_guide, on the robot. Twice as much makes joints ring."""
KD = np.tile([5.0, 4.0, 7.0], 4)
"""Levels [N·m·s/rad] of hip, thigh, calf. Source: as of KP. Twice as much amplifies the noise of speeds."""
DAMPING = 3.0
"""A level [N·m·s/rad]: gain of a damped robot. Source: unitree_guide. Twice as much lets it sink half as fast."""

ZERO = np.zeros(MOTORS)
STANDING = np.tile(leg.standing(leg.A1, STAND_HEIGHT), 4)
"""A definition: the stand, feet below the hips."""
LYING = np.tile([0.0, 1.305, -2.61], 4)
"""A definition: the pose in which lying down ends, 0.12 m high: the calves 0.09 rad before their stops."""

LIMP = Orders(ZERO, ZERO, ZERO, ZERO, ZERO)
"""A definition: no gain and no torque."""
DAMPED = Orders(ZERO, ZERO, ZERO, np.full(MOTORS, DAMPING), ZERO)
"""A definition: what a robot that must not move any more gets."""


class Motion(NamedTuple):
    """From a pose to a pose, in a span of time."""

    start: FloatArray
    target: FloatArray
    begun: int
    span: int


def done(motion: Motion, now: int) -> bool:
    """Return whether a motion has come to its end."""
    return now - motion.begun >= motion.span


def desired(motion: Motion, now: int) -> tuple[FloatArray, FloatArray]:
    """Return the angles and speeds that a motion asks for now [rad, rad/s]."""
    if done(motion, now):
        return motion.target, ZERO
    x = max(now - motion.begun, 0) / motion.span
    way = motion.target - motion.start
    return motion.start + x * x * (3.0 - 2.0 * x) * way, (6.0 * x * (1.0 - x) * 1e9 / motion.span) * way


def orders(motion: Motion, now: int) -> Orders:
    """Return the orders that make a motion."""
    q, dq = desired(motion, now)
    return Orders(q, dq, KP, KD, ZERO)


def standing_up(q: FloatArray, now: int) -> Motion:
    """Return the motion from measured angles to the stand."""
    return Motion(q, STANDING, now, STAND_UP)


def catching(q: FloatArray, tau: FloatArray, now: int) -> Motion:
    """Return the motion from a walk to the stand.

    It begins so far beyond the measured angles that the stand's gains make the torques that the motors make now:
    else the legs would give way until the load is taken over.
    """
    return Motion(q + np.clip(tau / KP, -YIELD, YIELD), STANDING, now, CATCH)


def lying_down(q: FloatArray, now: int) -> Motion:
    """Return the motion from the angles that the joints are held at to the end of lying down."""
    return Motion(q, LYING, now, LIE_DOWN)
