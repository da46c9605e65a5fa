"""The condensed inverse-dynamics QP: only the forces of the stance feet are unknown.

With every foot's acceleration prescribed, joint accelerations follow from the
base's, q̈ = N a + e, and the laws of motion leave both the base acceleration and
the torques affine in the foot forces:

    (M_bb + M_bj N) a = J_b'f − h_b − M_bj e                      a = A f + a₀
    τ = (M_jb + M_jj N) a + M_jj e + h_j − J_j'f                  τ = T f + τ₀

so 6 variables remain on two feet and 12 on four, with no equalities. It differs
from :mod:`s2r_sim.full_qp` only in that swing accelerations are exact here and
weighted there.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsymm
from scipy.linalg.lapack import dgesv

from s2r_sim.dynamics import RigidBody
from s2r_sim.figures import GRAVITY, Robot
from s2r_sim.gains import Gains
from s2r_sim.qp import Solution, Solver, Stance, Task, pyramid

FloatArray = NDArray[np.float64]


class StanceQP:
    """3 variables per stance foot; 4 pyramid rows each and 12 torque rows."""

    def __init__(self, gains: Gains, robot: Robot) -> None:
        # (I, 0) over (N, e): base acceleration and a constant, to all accelerations.
        self._motion = np.asfortranarray(np.eye(18, 7))
        self._legs = self._motion[6:]
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
        affine, contact = problem.affine, problem.contact
        body.jacobian.take(problem.loaded, axis=0, out=contact, mode="clip")

        # Rows 0-5 are the base's, 6-17 the joints': M_·b + M_·j N, and M_·j e + h in the last column.
        self._legs[:] = task.legs
        law = dsymm(1.0, body.mass_upper, self._motion)
        law[:, 6] += body.bias
        problem.rhs_forces[:] = problem.contact_base
        np.negative(law[:6, 6], out=problem.rhs_constant)
        problem.acceleration[:] = dgesv(law[:6, :6], problem.rhs)[2]
        np.matmul(law[6:], problem.with_one, out=problem.torque)
        problem.torque_forces -= problem.contact_legs

        deviation = task.base @ problem.with_one
        np.matmul(deviation.T, deviation, out=problem.cost)
        problem.cost += problem.share
        problem.torque_rows[:] = problem.torque_forces
        np.subtract(problem.limits, problem.torque_constant, out=problem.torque_bounds)
        found = self._solvers[problem.feet].solve(
            problem.bounds, P=problem.P, c=problem.c, G=problem.G, h_l=problem.h_l, h_u=problem.h_u
        )
        if found is None:
            return None
        f, iterations = found
        forces = np.zeros(12)
        forces[problem.loaded] = f
        problem.forces[:] = f
        answer = affine @ problem.forces_and_one
        return Solution(forces, answer[7:], answer[:6], iterations)


class _Problem:
    """What stays the same for one set of stance feet, and room for what does not, with the views of it in use.

    Attributes:
        loaded: (n,) indices of the force components.
        contact: (n, 18) the Jacobian of the loaded feet.
        rhs: (6, n + 1) of the laws of motion of the base.
        affine: (19, n + 1) base accelerations, one, and torques as functions of forces and one: A, a₀; 0, 1; T, τ₀.
        cost: (n + 1, n + 1) the quadratic cost of forces and one.
        share: the same of the pull towards equal shares of the weight.
        G, h_l, h_u: friction pyramids and torque limits.
        bounds: of the vertical forces.
    """

    def __init__(self, gains: Gains, robot: Robot, stance: Stance) -> None:
        self.loaded = np.flatnonzero(np.repeat(stance, 3))
        n = len(self.loaded)
        self.feet = feet = n // 3
        self.contact = np.empty((n, 18))
        self.contact_base, self.contact_legs = self.contact[:, :6].T, self.contact[:, 6:].T
        self.rhs = np.empty((6, n + 1), order="F")
        self.rhs_forces, self.rhs_constant = self.rhs[:, :n], self.rhs[:, n]
        self.affine = np.zeros((19, n + 1))
        self.affine[6, n] = 1.0
        self.acceleration, self.with_one, self.torque = self.affine[:6], self.affine[:7], self.affine[7:]
        self.torque_forces, self.torque_constant = self.torque[:, :n], self.torque[:, n]
        self.forces_and_one = np.ones(n + 1)
        self.forces = self.forces_and_one[:n]
        self.cost = np.empty((n + 1, n + 1))
        self.P, self.c = self.cost[:n, :n].T, self.cost[n, :n]
        self.share = gains.weight_force * np.eye(n + 1)
        self.share[n, 2:n:3] = -gains.weight_force * robot.mass * GRAVITY / feet
        self.G = np.asfortranarray(np.vstack([np.kron(np.eye(feet), pyramid(gains)), np.zeros((12, n))]))
        self.torque_rows = self.G[-12:]
        both = np.tile([[-np.inf], [0.0]], len(self.G))
        self.h_l, self.h_u = both
        self.torque_bounds = both[:, -12:]
        self.limits = np.tile([[-robot.torque_limit], [robot.torque_limit]], 12)
        self.bounds = {
            "x_l": np.tile([-np.inf, -np.inf, gains.min_force], feet),
            "x_u": np.tile([np.inf, np.inf, gains.max_force], feet),
        }
