"""From accelerations, torques and forces to forces alone: the linear algebra of one tick.

Compiled as one file, because what it calls for systems this small (3 x 3, 6 x 6)
costs more than it computes. Numbers that are not finite pass through: a state
that has diverged must end as a fall, not as an error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.compiled import compiled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@compiled
def solve(A: FloatArray, B: FloatArray) -> None:
    """Overwrite B (n, m) by the solution X of A X = B, and A (n, n): elimination with row pivots."""
    n = len(A)
    for k in range(n):
        pivot = k + np.argmax(np.abs(A[k:, k]))
        if pivot != k:
            for j in range(n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            for j in range(B.shape[1]):
                B[k, j], B[pivot, j] = B[pivot, j], B[k, j]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= factor * A[k, j]
            for j in range(B.shape[1]):
                B[i, j] -= factor * B[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(B.shape[1]):
            B[k, j] /= A[k, k]
        for i in range(k):
            for j in range(B.shape[1]):
                B[i, j] -= A[i, k] * B[k, j]


@compiled
def in_joint_space(jacobian: FloatArray, task: FloatArray, known: FloatArray) -> FloatArray:
    """Return (12, 9): response N (6 columns), joint accelerations e, joint steps, joint speeds.

    One factorisation of every leg's Jacobian serves q̈ = N a + e and both joint
    targets.

    Args:
        jacobian: (12, 18) Jacobian of the feet.
        task: (3, 12) result of :func:`foot_task`.
        known: (3, 12) the part of it that the joints need not bring about.
    """
    solved = np.empty((12, 9))
    for leg in range(4):
        first = 3 * leg
        own = jacobian[first : first + 3, 6 + first : 9 + first].copy()
        part = solved[first : first + 3]
        for row in range(3):
            for column in range(6):
                part[row, column] = -jacobian[first + row, column]
            for column in range(3):
                part[row, 6 + column] = task[column, first + row] - known[column, first + row]
        solve(own, part)
    return solved


@compiled
def condense(
    mass_upper: FloatArray,
    bias: FloatArray,
    jacobian: FloatArray,
    legs: FloatArray,
    base: FloatArray,
    loaded: IntArray,
    share: FloatArray,
    law: FloatArray,
    acceleration: FloatArray,
    cost: FloatArray,
) -> None:
    """Write the laws of motion, the base acceleration and the cost as functions of the stance forces.

    Args:
        mass_upper: (18, 18) mass matrix, of which the upper triangle is read.
        bias: (18,) Coriolis, centrifugal and gravity forces.
        jacobian: (12, 18) Jacobian of the feet.
        legs: (12, 9) result of :func:`in_joint_space`: N and e in its first seven columns.
        base: (6, 7) the base's task.
        loaded: (n,) indices of the force components.
        share: (n + 1, n + 1) cost of a deviation from equal shares.
        law: (18, 7) on return M (I, 0; N, e) + (0, h): forces on base and joints per base acceleration and one.
        acceleration: (7, n + 1) on return the base's, per forces and one; its last row gives that one.
        cost: (n + 1, n + 1) on return the quadratic cost of forces and one.
    """
    n = len(loaded)
    motion = np.zeros((18, 7))
    motion[6:] = legs[:, :7]
    law[:, :6] = 0.0
    law[:, 6] = bias
    for k in range(6):
        motion[k, k] = 1.0
    for i in range(18):
        for j in range(i, 18):
            mass = mass_upper[i, j]
            for k in range(7):
                law[i, k] += mass * motion[j, k]
            if j > i:
                for k in range(7):
                    law[j, k] += mass * motion[i, k]
    for row in range(6):
        for k in range(n):
            acceleration[row, k] = jacobian[loaded[k], row]
        acceleration[row, n] = -law[row, 6]
    acceleration[6, :n] = 0.0
    acceleration[6, n] = 1.0
    solve(law[:6, :6].copy(), acceleration[:6])
    deviation = base @ acceleration
    cost[:] = share + deviation.T @ deviation


@compiled
def distribute(
    law: FloatArray, acceleration: FloatArray, jacobian: FloatArray, loaded: IntArray, forces: FloatArray
) -> FloatArray:
    """Return (30,) forces on all feet, torques, and base acceleration that (n,) stance forces bring about.

    The other arguments are those of :func:`condense`.
    """
    n = len(forces)
    everything = np.zeros(30)
    torque, base = everything[12:24], everything[24:]
    for row in range(6):
        base[row] = acceleration[row, n]
        for k in range(n):
            base[row] += acceleration[row, k] * forces[k]
    for joint in range(12):
        torque[joint] = law[6 + joint, 6]
        for k in range(6):
            torque[joint] += law[6 + joint, k] * base[k]
    for k in range(n):
        everything[loaded[k]] = forces[k]
        for joint in range(12):
            torque[joint] -= jacobian[loaded[k], 6 + joint] * forces[k]
    return everything
