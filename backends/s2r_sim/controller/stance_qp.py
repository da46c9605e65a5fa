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
from s2r_sim.controller.reduction import base_acceleration, distribute, force_cost, laws_of_motion
from s2r_sim.robot.constants import GRAVITY, FloatArray, Robot


class StanceQP:
    """3 variables per stance foot; 4 pyramid rows each, and 12 torque rows where they matter.

    The torque rows rarely matter, and take half as much time again. So the first
    problem omits them: if its optimum satisfies them, it is the optimum with them,
    too. Otherwise a second problem has all rows.
    """

    def __init__(self, gains: Gains, robot: Robot) -> None:
        self._torque_limit = robot.torque_limit
        stances = filter(any, product((True, False), repeat=4))
        self._problems = {stance: _Problem(gains, robot, stance) for stance in stances}
        self._solvers = {feet: (Solver(), Solver()) for feet in (1, 2, 3, 4)}

    def reset(self) -> None:
        """Drop the solvers' workspaces."""
        for solvers in self._solvers.values():
            for solver in solvers:
                solver.reset()

    def solve(self, body: RigidBody, task: ControlTask) -> Solution | None:
        """Return the optimum, or None when the solver fails."""
        problem = self._problems[task.stance]
        freely, within_limits = self._solvers[problem.feet]
        problem.condense(body, task)
        optimum = freely.solve(problem.friction, P=problem.P, c=problem.c)
        if optimum is None:
            return None
        solution = problem.solution(body, *optimum)
        torque = solution.torque.tolist()
        if -self._torque_limit <= min(torque) and max(torque) <= self._torque_limit:
            return solution
        rows = problem.with_torque_rows(body, self._torque_limit)
        optimum = within_limits.solve(problem.bounds, P=problem.P, c=problem.c, **rows)
        if optimum is None:
            return None
        return problem.solution(body, optimum[0], solution.iterations + optimum[1])


class _Problem:
    """The QP of one set of stance feet: its constant parts, and memory for the parts that change each tick.

    Attributes:
        loaded: (n,) indices of the force components.
        law, acceleration, cost, share: see :mod:`s2r_sim.controller.reduction`.
        bounds: bounds of the vertical forces.
        friction: these bounds, and the friction pyramids.
    """

    def __init__(self, gains: Gains, robot: Robot, stance: Stance) -> None:
        self.loaded = np.flatnonzero(np.repeat(stance, 3))
        n = len(self.loaded)
        self.feet = feet = n // 3
        self.law = np.empty((18, 7))
        self.acceleration = np.empty((7, n + 1))
        self.cost = np.empty((n + 1, n + 1))
        self.P, self.c = self.cost[:n, :n].T, self.cost[n, :n]
        self.share = gains.weight_force * np.eye(n + 1)
        self.share[n, 2:n:3] = -gains.weight_force * robot.mass * GRAVITY / feet
        self.bounds = {
            "x_l": np.tile([-np.inf, -np.inf, gains.min_force], feet),
            "x_u": np.tile([np.inf, np.inf, gains.max_force], feet),
        }
        pyramids = np.kron(np.eye(feet), pyramid(gains))
        self.friction = {**self.bounds, "G": np.asfortranarray(pyramids), "h_u": np.zeros(4 * feet)}

    def condense(self, body: RigidBody, task: ControlTask) -> None:
        """Write the laws of motion, the base acceleration and the cost of a tick."""
        laws_of_motion(body.mass_upper, body.bias, task.legs, self.law)
        base_acceleration(self.law, body.jacobian, self.loaded, self.acceleration)
        force_cost(task.base, self.acceleration, self.share, self.cost)

    def solution(self, body: RigidBody, forces: FloatArray, iterations: int) -> Solution:
        """Return the solution of the QP with these (n,) forces on the stance feet."""
        solved = distribute(self.law, self.acceleration, body.jacobian, self.loaded, forces)
        return Solution(solved[:12], solved[12:24], solved[24:], iterations)

    def with_torque_rows(self, body: RigidBody, limit: float) -> dict[str, FloatArray]:
        """Return the friction pyramids and |τ| ≤ limit, with τ = T f + τ₀."""
        T = self.law[6:] @ self.acceleration
        T[:, :-1] -= body.leg_jacobian[self.loaded].T
        constant = T[:, -1]
        return {
            "G": np.asfortranarray(np.vstack([self.friction["G"], T[:, :-1]])),
            "h_l": np.concatenate([np.full(4 * self.feet, -np.inf), -limit - constant]),
            "h_u": np.concatenate([self.friction["h_u"], limit - constant]),
        }
