"""The linear algebra of one tick: accelerations and torques as functions of the stance forces.

The file is compiled, because a call of LAPACK takes longer than the solution of
systems this small (3 x 3, 6 x 6). Numbers that are not finite pass through: a
diverged state must end as a fall, not as an error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_sim.robot.constants import FloatArray
from s2r_spec.compiled import compiled

IntArray = NDArray[np.int64]


@compiled
def solve(A: FloatArray, B: FloatArray) -> None:
    """Overwrite B (n, m) by the solution X of A X = B, and A (n, n): elimination with row pivots."""
    n = len(A)
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
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
def in_joint_space(
    jacobian: FloatArray, task: FloatArray, known: FloatArray, q: FloatArray, bound: float, legs: FloatArray
) -> FloatArray:
    """Write joint accelerations as a function of the base's; return (2, 12) target angles and speeds of the joints.

    One factorisation of each leg's Jacobian gives q̈ = N a + e, the joint steps and
    the joint speeds.

    Args:
        jacobian: (12, 18) Jacobian of the feet.
        task: (3, 12) result of :func:`s2r_sim.controller.foot_task.foot_task`.
        known: (3, 12) motion of the feet without the joints; see :class:`s2r_sim.controller.dynamics.RigidBody`.
        q: (12,) joint angles [rad].
        bound: largest distance of a target angle from its joint's [rad].
        legs: (12, 7) on return N (6 columns) and e.
    """
    targets, own, part = np.empty((2, 12)), np.empty((3, 3)), np.empty((3, 9))
    for leg in range(4):
        first = 3 * leg
        for row in range(3):
            for column in range(6):
                part[row, column] = -jacobian[first + row, column]
            for column in range(3):
                own[row, column] = jacobian[first + row, 6 + first + column]
                part[row, 6 + column] = task[column, first + row] - known[column, first + row]
        solve(own, part)
        for row in range(3):
            joint = first + row
            for column in range(7):
                legs[joint, column] = part[row, column]
            targets[0, joint] = q[joint] + min(max(part[row, 7], -bound), bound)
            targets[1, joint] = part[row, 8]
    return targets


@compiled
def laws_of_motion(mass_upper: FloatArray, bias: FloatArray, legs: FloatArray, law: FloatArray) -> None:
    """Write the generalised forces M q̈ + h as a function of the base acceleration a; the joints have q̈ = N a + e.

    Args:
        mass_upper: (18, 18) mass matrix M; only its upper triangle is read.
        bias: (18,) Coriolis, centrifugal and gravity forces h.
        legs: (12, 7) N and e, written by :func:`in_joint_space`.
        law: (18, 7) on return M (I, 0; N, e) + (0, h), a matrix that acts on (a, 1).
    """
    law[:, :6] = 0.0
    law[:, 6] = bias
    for i in range(6):
        for j in range(6):
            law[i, j] = mass_upper[min(i, j), max(i, j)]
        for j in range(12):
            mass = mass_upper[i, 6 + j]
            law[6 + j, i] = mass
            for k in range(7):
                law[i, k] += mass * legs[j, k]
    for i in range(12):
        first = i // 3 * 3  # joints of two legs have no mass in common
        for j in range(first, first + 3):
            mass = mass_upper[6 + min(i, j), 6 + max(i, j)]
            for k in range(7):
                law[6 + i, k] += mass * legs[j, k]


@compiled
def base_acceleration(
    law: FloatArray, jacobian: FloatArray, loaded: IntArray, acceleration: FloatArray
) -> None:
    """Write the base acceleration as a function of the stance forces f, from the six laws without a motor.

    Args:
        law: (18, 7) result of :func:`laws_of_motion`.
        jacobian: (12, 18) Jacobian of the feet.
        loaded: (n,) indices of the force components.
        acceleration: (7, n + 1) on return the matrix (A, a₀; 0, 1), which turns (f, 1) into (a, 1).
    """
    n = len(loaded)
    for row in range(6):
        for k in range(n):
            acceleration[row, k] = jacobian[loaded[k], row]
        acceleration[row, n] = -law[row, 6]
    acceleration[6, :n] = 0.0
    acceleration[6, n] = 1.0
    solve(law[:6, :6].copy(), acceleration[:6])


@compiled
def force_cost(base: FloatArray, acceleration: FloatArray, share: FloatArray, cost: FloatArray) -> None:
    """Write the cost (f, 1)' C (f, 1) of stance forces f: the deviation from the base's task, and unequal shares.

    Args:
        base: (6, 7) the base's task.
        acceleration: (7, n + 1) result of :func:`base_acceleration`.
        share: (n + 1, n + 1) the cost of a deviation from equal shares.
        cost: (n + 1, n + 1) on return C.
    """
    size = cost.shape[0]
    deviation = np.zeros((6, size))
    for row in range(6):
        for k in range(7):
            for column in range(size):
                deviation[row, column] += base[row, k] * acceleration[k, column]
    cost[:] = share
    for row in range(6):
        for i in range(size):
            for j in range(size):
                cost[i, j] += deviation[row, i] * deviation[row, j]


@compiled
def distribute(
    law: FloatArray, acceleration: FloatArray, jacobian: FloatArray, loaded: IntArray, forces: FloatArray
) -> FloatArray:
    """Return (30,) forces on all feet, torques, and base acceleration that (n,) stance forces cause.

    The other arguments are those of :func:`base_acceleration`, after that function.
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


@compiled
def optimum_without_limits(
    motion: tuple[FloatArray, FloatArray, FloatArray],
    task: tuple[FloatArray, FloatArray],
    loaded: IntArray,
    share: FloatArray,
    memory: tuple[FloatArray, FloatArray, FloatArray],
    limits: tuple[float, float, float, float],
) -> tuple[FloatArray, bool]:
    """Return (30,) forces, torques and base acceleration of least cost, and whether they keep the limits.

    If they do, they are the optimum with the limits, too. Not finite numbers keep no limit.

    Args:
        motion: mass matrix, bias and Jacobian; see :func:`laws_of_motion` and :func:`base_acceleration`.
        task: (6, 7) the base's task, and (12, 7) N and e.
        loaded: (n,) indices of the force components.
        share: (n + 1, n + 1) the cost of a deviation from equal shares.
        memory: on return the results of :func:`laws_of_motion`, :func:`base_acceleration` and :func:`force_cost`.
        limits: friction coefficient of the pyramids, least and largest vertical force [N], largest torque [N m].
    """
    mass_upper, bias, jacobian = motion
    base, legs = task
    law, acceleration, cost = memory
    friction, least, most, torque = limits
    laws_of_motion(mass_upper, bias, legs, law)
    base_acceleration(law, jacobian, loaded, acceleration)
    force_cost(base, acceleration, share, cost)
    n = len(loaded)
    solved = -cost[n:, :n].T.copy()
    solve(cost[:n, :n].copy(), solved)
    forces = solved[:, 0]
    everything = distribute(law, acceleration, jacobian, loaded, forces)
    kept = True
    for k in range(0, n, 3):
        sideways = friction * forces[k + 2]
        kept = kept and abs(forces[k]) <= sideways and abs(forces[k + 1]) <= sideways
        kept = kept and least <= forces[k + 2] <= most
    for joint in range(12, 24):
        kept = kept and abs(everything[joint]) <= torque
    return everything, kept
