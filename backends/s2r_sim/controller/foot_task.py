"""The foot tasks: stance feet stay where they are, swing feet follow their polynomial to Raibert's foothold."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np

from s2r_sim.robot.constants import FloatArray
from s2r_spec.compiled import compiled

Pair = tuple[float, float]
Point = tuple[float, float, float]

STANDS = -1.0
"""Value for a standing foot, in place of the progress of a swing."""


class FootTarget(NamedTuple):
    """Position [m], velocity [m/s] and acceleration [m/s²] of a swing foot, world axes."""

    position: Point
    velocity: Point
    acceleration: Point


@compiled
def raibert(
    hip: Pair, velocity: Pair, commanded: Pair, time_to_go: float, stance_time: float, gain: float
) -> Pair:
    """Return the foothold (x, y) [m], world axes.

    ``hip + v (t_go + T_stance / 2) + k (v − v_d)``: below the hip in the middle
    of the coming stance, shifted to brake or to push. Raibert, *Legged Robots
    That Balance*, MIT Press 1986.

    Args:
        hip: position of the thigh joint [m].
        velocity: velocity of that point [m/s].
        commanded: the velocity it should have [m/s].
        time_to_go: time until touch-down [s].
        stance_time: duration of the coming stance [s].
        gain: k [s].
    """
    ahead = time_to_go + stance_time / 2
    return (
        hip[0] + velocity[0] * ahead + gain * (velocity[0] - commanded[0]),
        hip[1] + velocity[1] * ahead + gain * (velocity[1] - commanded[1]),
    )


@compiled
def swing(start: Point, end: Point, height: float, s: float, duration: float) -> FootTarget:
    """Return the target at progress ``s`` in [0, 1] of a swing that lasts ``duration`` [s].

    The foot moves from start to end by the minimum-jerk polynomial 10 s³ − 15 s⁴ + 6 s⁵.
    In z it adds the bump 64 s³ (1 − s)³, twice continuously differentiable, times the
    height [m].
    """
    r = 1.0 - s
    line = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
    d_line = 30.0 * s * s * r * r / duration
    dd_line = 60.0 * s * r * (1.0 - 2.0 * s) / duration**2
    bump = 64.0 * height * (s * r) ** 3
    d_bump = 192.0 * height * (s * r) ** 2 * (1.0 - 2.0 * s) / duration
    dd_bump = 384.0 * height * s * r * (1.0 - 5.0 * s * r) / duration**2
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return FootTarget(
        (start[0] + dx * line, start[1] + dy * line, start[2] + dz * line + bump),
        (dx * d_line, dy * d_line, dz * d_line + d_bump),
        (dx * dd_line, dy * dd_line, dz * dd_line + dd_bump),
    )


@compiled
def note_stance(progress: FloatArray, feet: FloatArray, lift_off: FloatArray) -> float:
    """Copy the positions of standing feet to ``lift_off``, and return their mean height [m]."""
    height, standing = 0.0, 0
    for leg in range(4):
        if progress[leg] == STANDS:
            lift_off[leg] = feet[leg]
            height += feet[leg, 2]
            standing += 1
    return height / standing


@compiled
def footholds(
    progress: FloatArray,
    thighs: FloatArray,
    measured: FloatArray,
    command: Point,
    height: float,
    times: Pair,
    gain: float,
) -> FloatArray:
    """Return (4, 3) the points where swing feet are to touch down [m], world axes; 0 for a standing foot.

    Args:
        progress: (4,) progress of each swing, in [0, 1), or ``STANDS``.
        thighs: (4, 3) positions of the thigh joints [m].
        measured: ``State.flat``.
        command: forward, left [m/s] and yaw rate [rad/s].
        height: height of the ball centre at touch-down [m].
        times: duration of a swing and of a stance [s].
        gain: the gain of :func:`raibert` [s].
    """
    swing_time, stance_time = times
    x, y, yaw, vx, vy = measured[0], measured[1], measured[5], measured[6], measured[7]
    forward, left, turn = command
    commanded_x = cos(yaw) * forward - sin(yaw) * left
    commanded_y = sin(yaw) * forward + cos(yaw) * left
    landing = np.zeros((4, 3))
    for leg in range(4):
        s = progress[leg]
        if s != STANDS:
            thigh_x, thigh_y = thighs[leg, 0], thighs[leg, 1]
            # The hip also moves because the base turns; the commanded rate has less noise than the measured one.
            turn_x, turn_y = -turn * (thigh_y - y), turn * (thigh_x - x)
            landing[leg, 0], landing[leg, 1] = raibert(
                (thigh_x, thigh_y),
                (vx + turn_x, vy + turn_y),
                (commanded_x + turn_x, commanded_y + turn_y),
                (1.0 - s) * swing_time,
                stance_time,
                gain,
            )
            landing[leg, 2] = height
    return landing


@compiled
def foot_task(
    progress: FloatArray,
    lift_off: FloatArray,
    legs: FloatArray,
    measured: FloatArray,
    command: Point,
    constants: tuple[float, float, float, float, float, float, float, float],
    task: FloatArray,
) -> float:
    """Write the task of the four feet at this tick, and return the mean height of those that stand [m].

    The rows of the task are the desired acceleration [m/s²], the error to the target
    position [m] and the target's velocity [m/s]; the last two are 0 in stance.

    Args:
        progress: (4,) progress of each swing, in [0, 1), or ``STANDS``.
        lift_off: (4, 3) last position of each foot in stance [m]; on return that of this tick.
        legs: (3, 4, 3) positions of the feet and of the thigh joints [m], velocities of the feet [m/s].
        measured: ``State.flat``.
        command: forward, left [m/s] and yaw rate [rad/s].
        constants: kp [1/s²] and kd [1/s] of the swing, damping of the stance [1/s], swing height [m], depth of the
            touch-down [m], foothold gain [s], duration of a swing and of a stance [s].
        task: (3, 12) on return the task, world axes, three numbers a foot.
    """
    kp, kd, damping, height, depth, foothold_gain, swing_time, stance_time = constants
    feet, thighs, speeds = legs[0], legs[1], legs[2]
    times = (swing_time, stance_time)
    contact = note_stance(progress, feet, lift_off)
    landing = footholds(progress, thighs, measured, command, contact - depth, times, foothold_gain)
    task[:] = 0.0
    for leg in range(4):
        s = progress[leg]
        if s == STANDS:
            task[0, 3 * leg : 3 * leg + 3] = -damping * speeds[leg]
            continue
        start = (lift_off[leg, 0], lift_off[leg, 1], lift_off[leg, 2])
        end = (landing[leg, 0], landing[leg, 1], landing[leg, 2])
        target = swing(start, end, height, s, swing_time)
        for axis in range(3):
            missing = target.position[axis] - feet[leg, axis]
            speed = target.velocity[axis]
            task[0, 3 * leg + axis] = (
                target.acceleration[axis] + kd * (speed - speeds[leg, axis]) + kp * missing
            )
            task[1, 3 * leg + axis] = missing
            task[2, 3 * leg + axis] = speed
    return contact
