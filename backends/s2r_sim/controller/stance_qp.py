"""The condensed inverse-dynamics QP: only the forces of the stance feet are unknown.

With every foot's acceleration prescribed, joint accelerations follow from the
base's, q̈ = N a + e. By the laws of motion the base acceleration and the torques
are then affine in the foot forces:

    (M_bb + M_bj N) a = J_b'f − h_b − M_bj e                      a = A f + a₀
    τ = (M_jb + M_jj N) a + M_jj e + h_j − J_j'f                  τ = T f + τ₀

So 6 variables remain on two feet and 12 on four, without equalities. There is one
difference from :mod:`s2r_sim.controller.full_qp`: swing accelerations are exact here and
weighted there.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from s2r_sim.controller.dynamics import RigidBody
from s2r_sim.controller.gains import Gains
from s2r_sim.controller.qp import ControlTask, Solution, Solver, Stance, pyramid
from s2r_sim.controller.reduction import distribute, optimum_without_limits
from s2r_sim.robot.constants import GRAVITY, FloatArray, Robot


class StanceQP:
    """3 variables per stance foot; 4 pyramid rows each, and 12 torque rows, where they matter.

    They rarely matter, and PIQP takes twenty times as long as the optimum without them, one
    linear system. So this comes first: if it keeps the limits, it is the optimum with them, too.
    """

    def __init__(self, gains: Gains, robot: Robot) -> None:
        stances = filter(any, product((True, False), repeat=4))
        self._problems = {stance: _Problem(gains, robot, stance) for stance in stances}
        self._solvers = {feet: Solver() for feet in (1, 2, 3, 4)}

    def reset(self) -> None:
        """Drop the solvers' workspaces."""
        for solver in self._solvers.values():
            solver.reset()

    def solve(self, body: RigidBody, task: ControlTask) -> Solution | None:
        """Return the optimum, or None when the solver fails."""
        problem = self._problems[task.stance]
        solution = problem.without_limits(body, task)
        if solution is not None:
            return solution
        optimum = self._solvers[problem.feet].solve(problem.bounds, **problem.rows(body))
        return None if optimum is None else problem.solution(body, *optimum)


class _Problem:
    """The QP of one set of stance feet: its constant parts, and memory for the parts that change each tick.

    Attributes:
        loaded: (n,) indices of the force components.
        share, memory, limits: see :func:`s2r_sim.controller.reduction.optimum_without_limits`.
        bounds: bounds of the vertical forces.
    """

    def __init__(self, gains: Gains, robot: Robot, stance: Stance) -> None:
        self.loaded = np.flatnonzero(np.repeat(stance, 3))
        n = len(self.loaded)
        self.feet = feet = n // 3
        self.memory = np.empty((18, 7)), np.empty((7, n + 1)), np.empty((n + 1, n + 1))
        self.share = gains.weight_force * np.eye(n + 1)
        self.share[n, 2:n:3] = -gains.weight_force * robot.mass * GRAVITY / feet
        self.limits = (gains.friction, gains.min_force, gains.max_force, robot.torque_limit)
        self.bounds = {
            "x_l": np.tile([-np.inf, -np.inf, gains.min_force], feet),
            "x_u": np.tile([np.inf, np.inf, gains.max_force], feet),
        }
        self._pyramids = np.kron(np.eye(feet), pyramid(gains))

    def without_limits(self, body: RigidBody, task: ControlTask) -> Solution | None:
        """Write ``memory``; return the optimum without limits if it keeps them."""
        solved, kept = optimum_without_limits(
            body.motion, (task.base, task.legs), self.loaded, self.share, self.memory, self.limits
        )
        return Solution(solved[:12], solved[12:24], solved[24:], 0) if kept else None

    def solution(self, body: RigidBody, forces: FloatArray, iterations: int) -> Solution:
        """Return the solution of the QP with these (n,) forces on the stance feet."""
        law, acceleration, _ = self.memory
        solved = distribute(law, acceleration, body.jacobian, self.loaded, forces)
        return Solution(solved[:12], solved[12:24], solved[24:], iterations)

    def rows(self, body: RigidBody) -> dict[str, FloatArray]:
        """Return the cost, the friction pyramids, and |τ| ≤ limit with τ = T f + τ₀."""
        n = len(self.loaded)
        law, acceleration, cost = self.memory
        T = law[6:] @ acceleration
        T[:, :n] -= body.leg_jacobian[self.loaded].T
        constant, limit = T[:, n], self.limits[3]
        return {
            "P": cost[:n, :n].T,
            "c": cost[n, :n],
            "G": np.asfortranarray(np.vstack([self._pyramids, T[:, :n]])),
            "h_l": np.concatenate([np.full(4 * self.feet, -np.inf), -limit - constant]),
            "h_u": np.concatenate([np.zeros(4 * self.feet), limit - constant]),
        }
