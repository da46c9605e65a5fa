"""Motion of the feet: Jacobian, velocity and drift, from the one Jacobian of all bodies that Pinocchio gives."""

from __future__ import annotations

import numpy as np

from s2r_sim.robot.constants import FloatArray
from s2r_spec.compiled import compiled


@compiled
def add_cross(total: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Add a × b to a (3,) total."""
    total[0] += a[1] * b[2] - a[2] * b[1]
    total[1] += a[2] * b[0] - a[0] * b[2]
    total[2] += a[0] * b[1] - a[1] * b[0]


@compiled
def at_feet(
    J: FloatArray,
    feet: FloatArray,
    twist: FloatArray,
    jacobian: FloatArray,
    speeds: FloatArray,
    known: FloatArray,
) -> None:
    """Move the bodies' Jacobian from the world's origin to the feet, v = v₀ + ω × p, and the motion with it.

    A foot's drift J̇ v is its acceleration while joints and base have none. The
    motion m of its parent link turns the spatial velocity s of every joint. Their sum
    Σ m × s is a spatial acceleration (a₀, α). At the foot it is a₀ + α × p + ω × v.

    Args:
        J: (6, 18) spatial velocity at the world's origin per twist; a body moves with its own joints' columns only.
        feet: (4, 3) positions of the feet [m].
        twist: (18,) velocity of base and joints.
        jacobian: (12, 18) on return that of the feet; the columns of other legs do not change.
        speeds: (4, 3) on return those of the feet [m/s].
        known: (3, 12) on return the drift, and the feet's velocity at zero joint speed; row 1 does not change.
    """
    for leg in range(4):
        rows, foot = slice(3 * leg, 3 * leg + 3), feet[leg]
        m, a = np.zeros(6), np.zeros(6)
        for k in range(9):
            column = k if k < 6 else 3 * leg + k
            jacobian[rows, column] = J[:3, column]
            add_cross(jacobian[rows, column], J[3:, column], foot)
            s = J[:, column] * twist[column]
            if k >= 6:
                add_cross(a[:3], m[3:], s[:3])
                add_cross(a[:3], m[:3], s[3:])
                add_cross(a[3:], m[3:], s[3:])
            m += s
            if k == 5:
                known[2, rows] = m[:3]
                add_cross(known[2, rows], m[3:], foot)
        speeds[leg] = m[:3]
        add_cross(speeds[leg], m[3:], foot)
        known[0, rows] = a[:3]
        add_cross(known[0, rows], a[3:], foot)
        add_cross(known[0, rows], m[3:], speeds[leg])
