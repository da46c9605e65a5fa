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

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv

from s2r_sim.dynamics import RigidBody
from s2r_sim.figures import Robot
from s2r_sim.gains import Gains
from s2r_sim.qp import Solution, Solver, Stance, Task, pyramid

FloatArray = NDArray[np.float64]


class StanceQP:
    """3 variables per stance foot; 4 pyramid rows each and 12 torque rows."""

    def __init__(self, gains: Gains, robot: Robot) -> None:
        self._gains = gains
        self._torque_limit = robot.torque_limit
        self._rows = {feet: _Rows(gains, feet) for feet in (1, 2, 3, 4)}

    def reset(self) -> None:
        """Drop the solvers' workspaces."""
        for rows in self._rows.values():
            rows.solver.reset()

    def solve(self, body: RigidBody, task: Task) -> Solution | None:
        """Return the optimum, or None when the solver fails."""
        gains, M, N, e = self._gains, body.mass_matrix, task.leg_response, task.leg_acceleration
        M_bj, M_jj = M[:6, 6:], M[6:, 6:]
        loaded = _force_indices(task.stance)
        n = len(loaded)

        rhs = np.empty((6, n + 1), order="F")
        rhs[:, :n] = body.base_jacobian[loaded].T
        rhs[:, n] = -body.bias[:6] - M_bj @ e
        affine = dgesv(M[:6, :6] - M_bj @ N, rhs)[2]
        A, a0 = affine[:, :n], affine[:, n]

        coupling = M_bj.T - M_jj @ N
        T = coupling @ A - body.leg_jacobian[loaded].T
        tau0 = coupling @ a0 + M_jj @ e + body.bias[6:]

        WA = task.weight @ A
        P = A.T @ WA
        P.flat[:: n + 1] += gains.weight_force
        c = WA.T @ (a0 - task.base)
        c[2::3] -= gains.weight_force * 3.0 * body.weight / n

        rows = self._rows[n // 3]
        rows.G[-12:] = T
        rows.h_l[-12:] = -self._torque_limit - tau0
        rows.h_u[-12:] = self._torque_limit - tau0
        found = rows.solver.solve(
            P=P.T, c=c, G=rows.G, h_l=rows.h_l, h_u=rows.h_u, x_l=rows.x_l, x_u=rows.x_u
        )
        if found is None:
            return None
        f, iterations = found
        forces = np.zeros(12)
        forces[loaded] = f
        return Solution(forces, T @ f + tau0, A @ f + a0, iterations)


class _Rows:
    """Constraint rows and PIQP workspace for one number of stance feet."""

    def __init__(self, gains: Gains, feet: int) -> None:
        friction = np.kron(np.eye(feet), pyramid(gains))
        self.solver = Solver()
        self.G = np.asfortranarray(np.vstack([friction, np.zeros((12, 3 * feet))]))
        self.h_l = np.full(len(self.G), -np.inf)
        self.h_u = np.zeros(len(self.G))
        self.x_l = np.tile([-np.inf, -np.inf, gains.min_force], feet)
        self.x_u = np.tile([np.inf, np.inf, gains.max_force], feet)


@cache
def _force_indices(stance: Stance) -> list[int]:
    return [3 * leg + axis for leg, stands in enumerate(stance) if stands for axis in range(3)]
