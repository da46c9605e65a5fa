"""Where a swing foot lands, and how it gets there. Plain numbers: for three of them numpy is slow."""

from __future__ import annotations

from typing import NamedTuple

Pair = tuple[float, float]
Point = tuple[float, float, float]


class FootTarget(NamedTuple):
    """Position [m], velocity [m/s] and acceleration [m/s²] of a swing foot, world axes."""

    position: Point
    velocity: Point
    acceleration: Point


def raibert(
    hip: Pair, velocity: Pair, commanded: Pair, time_to_go: float, stance_time: float, gain: float
) -> Pair:
    """Return the foothold (x, y) [m], world axes.

    ``hip + v (t_go + T_stance / 2) + k (v − v_d)``: below the hip in the middle
    of the coming stance, shifted to brake or to push. Raibert, *Legged Robots
    That Balance*, MIT Press 1986.

    Args:
        hip: position of the thigh joint [m].
        velocity: of that point [m/s].
        commanded: the velocity it should have [m/s].
        time_to_go: until touch-down [s].
        stance_time: duration of the coming stance [s].
        gain: k [s].
    """
    ahead = time_to_go + stance_time / 2
    return (
        hip[0] + velocity[0] * ahead + gain * (velocity[0] - commanded[0]),
        hip[1] + velocity[1] * ahead + gain * (velocity[1] - commanded[1]),
    )


def swing(start: Point, end: Point, height: float, s: float, duration: float) -> FootTarget:
    """Return the target at progress ``s`` in [0, 1] of a swing that lasts ``duration`` [s].

    Minimum-jerk polynomial 10 s³ − 15 s⁴ + 6 s⁵ from start to end, and in z the
    twice continuously differentiable bump 64 s³ (1 − s)³ of the given height [m].
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
