"""The plain inverse-dynamics QP: 18 accelerations and 12 foot forces, every law of motion a row.

x = (base acceleration 6, joint accelerations 12, foot forces 12). A row has the
same place in every gait phase, so one workspace serves the whole rollout.
This QP is the reference for the condensed form in :mod:`s2r_sim.controller.stance_qp`.
"""

from __future__ import annotations

import numpy as np

from s2r_sim.controller.dynamics import RigidBody
from s2r_sim.controller.gains import Gains
from s2r_sim.controller.qp import ControlTask, Solution, Solver, pyramid
from s2r_sim.robot.constants import GRAVITY, FloatArray, Robot


class FullQP:
    """30 variables, 18 equalities, 28 inequality rows."""

    def __init__(self, gains: Gains, robot: Robot) -> None:
        self._gains = gains
        self._torque_limit = robot.torque_limit
        self._weight = robot.mass * GRAVITY
        self._solver = Solver()
        self._G = np.zeros((28, 30), order="F")
        self._G[:16, 18:] = np.kron(np.eye(4), pyramid(gains))

    def reset(self) -> None:
        """Drop the solver's workspace."""
        self._solver.reset()

    def solve(self, body: RigidBody, task: ControlTask) -> Solution | None:
        """Return the optimum, or None when the solver fails."""
        A, b = self._laws_of_motion(body, task)
        P, c = self._cost(body, task)
        lower, upper = self._row_bounds(body, task)
        x_l, x_u = np.full(30, -np.inf), np.full(30, np.inf)
        up = 20 + 3 * np.flatnonzero(task.stance)
        x_l[up], x_u[up] = self._gains.min_force, self._gains.max_force
        optimum = self._solver.solve(
            {}, P=P, c=c, A=A, b=b, G=self._G, h_l=lower, h_u=upper, x_l=x_l, x_u=x_u
        )
        if optimum is None:
            return None
        x, iterations = optimum
        return Solution(x[18:], self._G[16:] @ x + body.bias[6:], x[:6], iterations)

    def _laws_of_motion(self, body: RigidBody, task: ControlTask) -> tuple[FloatArray, FloatArray]:
        """Return A and b: six floating-base rows, then each foot's acceleration (stance) or zero force (swing)."""
        A = np.zeros((18, 30), order="F")
        b = np.empty(18)
        A[:6, :18] = body.mass_matrix[:6]
        A[:6, 18:] = -body.base_jacobian.T
        b[:6] = -body.bias[:6]
        for leg, stands in enumerate(task.stance):
            rows, feet = slice(6 + 3 * leg, 9 + 3 * leg), slice(3 * leg, 3 * leg + 3)
            if stands:
                A[rows, :18] = body.jacobian[feet]
                b[rows] = task.feet[0, feet] - body.drift[feet]
            else:
                A[rows, 18 + 3 * leg : 21 + 3 * leg] = np.eye(3)
                b[rows] = 0.0
        return A, b

    def _cost(self, body: RigidBody, task: ControlTask) -> tuple[FloatArray, FloatArray]:
        gains = self._gains
        P = np.zeros((30, 30), order="F")
        c = np.zeros(30)
        root, target = task.base[:, :6], task.base[:, 6]
        weight = root.T @ root
        P[:6, :6] = weight
        c[:6] = root.T @ target
        for leg, stands in enumerate(task.stance):
            if not stands:
                feet = slice(3 * leg, 3 * leg + 3)
                J = body.jacobian[feet]
                P[:18, :18] += gains.weight_swing * J.T @ J
                c[:18] -= gains.weight_swing * J.T @ (task.feet[0, feet] - body.drift[feet])
        P[range(18), range(18)] += gains.weight_acceleration
        P[range(18, 30), range(18, 30)] += gains.weight_force
        share = self._weight / sum(task.stance)
        c[20::3] -= gains.weight_force * share * np.array(task.stance, dtype=float)
        return P, c

    def _row_bounds(self, body: RigidBody, task: ControlTask) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of the friction pyramids, then of |τ| ≤ limit with τ = M a + h − J'f."""
        G = self._G
        G[16:, :18] = body.mass_matrix[6:]
        G[16:, 18:] = -body.leg_jacobian.T
        # In swing f = 0 makes a row 0 ≤ 0, without interior points: these rows get slack.
        slack = np.repeat([0.0 if stands else 1.0 for stands in task.stance], 4)
        lower = np.concatenate([np.full(16, -np.inf), -self._torque_limit - body.bias[6:]])
        upper = np.concatenate([slack, self._torque_limit - body.bias[6:]])
        return lower, upper
