"""The condensed inverse-dynamics QP: only the forces of the stance feet are unknown.

With every foot's acceleration prescribed, joint accelerations follow from the
base's, q̈ = e − N a, and the laws of motion leave both the base acceleration and
the torques affine in the foot forces:

    (M_bb − M_bj N) a = J_b'f − h_b − M_bj e                      a = A f + a₀
    τ = (M_jb − M_jj N) a + M_jj e + h_j − J_j'f                  τ = T f + τ₀

so 6 variables remain on two feet and 12 on four, with no equalities. It differs
from :mod:`s2r_sim.full_qp` only in that swing accelerations are exact here and
weighted there.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv

from s2r_sim.dynamics import RigidBody
from s2r_sim.figures import GRAVITY, Robot
from s2r_sim.gains import Gains
from s2r_sim.qp import Solution, Solver, Stance, Task, pyramid

FloatArray = NDArray[np.float64]


class StanceQP:
    """3 variables per stance foot; 4 pyramid rows each and 12 torque rows."""

    def __init__(self, gains: Gains, robot: Robot) -> None:
        self._torque_limit = robot.torque_limit
        self._problems = {
            (a, b, c, d): _Problem(gains, robot, (a, b, c, d))
            for a, b, c, d in product((True, False), repeat=4)
            if a or b or c or d
        }
        self._solvers = {feet: Solver() for feet in (1, 2, 3, 4)}

    def reset(self) -> None:
        """Drop the solvers' workspaces."""
        for solver in self._solvers.values():
            solver.reset()

    def solve(self, body: RigidBody, task: Task) -> Solution | None:
        """Return the optimum, or None when the solver fails."""
        problem = self._problems[task.stance]
        n, affine = problem.size, problem.affine
        contact = body.jacobian.take(problem.loaded, axis=0)

        # Rows 0-5 are the base's, 6-17 the joints': M_·b − M_·j N, and −(h + M_·j e) in the last column.
        M = body.mass_matrix
        law = M[:, 6:] @ task.legs
        np.subtract(M[:, :6], law[:, :6], out=law[:, :6])
        law[:, 6] += body.bias
        problem.rhs[:, :n] = contact[:, :6].T
        np.negative(law[:6, 6], out=problem.rhs[:, n])
        affine[:6] = dgesv(law[:6, :6], problem.rhs)[2]
        np.matmul(law[6:, :6], affine[:6], out=affine[6:])
        affine[6:, :n] -= contact[:, 6:].T
        affine[6:, n] += law[6:, 6]

        deviation = affine[:6].copy()
        deviation[:, n] -= task.base.acceleration
        deviation = task.base.root @ deviation
        gram = deviation.T @ deviation
        gram += problem.gram
        tau0 = affine[6:, n]
        problem.G[-12:] = affine[6:, :n]
        np.subtract(-self._torque_limit, tau0, out=problem.h_l[-12:])
        np.subtract(self._torque_limit, tau0, out=problem.h_u[-12:])
        found = self._solvers[n // 3].solve(
            problem.bounds, P=gram[:n, :n].T, c=gram[n, :n], G=problem.G, h_l=problem.h_l, h_u=problem.h_u
        )
        if found is None:
            return None
        f, iterations = found
        forces = np.zeros(12)
        forces[problem.loaded] = f
        answer = affine[:, :n] @ f + affine[:, n]
        return Solution(forces, answer[6:], answer[:6], iterations)


class _Problem:
    """What stays the same for one set of stance feet, and room for what does not.

    Attributes:
        loaded: (n,) indices of the force components.
        rhs: (6, n + 1) of the laws of motion of the base.
        affine: (18, n + 1) base accelerations and torques as functions of the forces: A, a₀; T, τ₀.
        gram: (n + 1, n + 1) the pull towards equal shares of the weight: its P, and its c in the last row.
        G, h_l, h_u: friction pyramids and torque limits.
        bounds: of the vertical forces.
    """

    def __init__(self, gains: Gains, robot: Robot, stance: Stance) -> None:
        self.loaded = np.flatnonzero(np.repeat(stance, 3))
        self.size = n = len(self.loaded)
        feet = n // 3
        self.rhs = np.empty((6, n + 1), order="F")
        self.affine = np.empty((18, n + 1))
        self.gram = gains.weight_force * np.eye(n + 1)
        self.gram[n, 2:n:3] = -gains.weight_force * robot.mass * GRAVITY / feet
        self.G = np.asfortranarray(np.vstack([np.kron(np.eye(feet), pyramid(gains)), np.zeros((12, n))]))
        self.h_l = np.full(len(self.G), -np.inf)
        self.h_u = np.zeros(len(self.G))
        self.bounds = {
            "x_l": np.tile([-np.inf, -np.inf, gains.min_force], feet),
            "x_u": np.tile([np.inf, np.inf, gains.max_force], feet),
        }
