"""Common parts of every form of the inverse-dynamics QP: its task, its solution, its constraints, PIQP."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import piqp

from s2r_sim.controller.gains import Gains
from s2r_sim.robot.constants import FloatArray

Stance = tuple[bool, ...]

_SOLVED = piqp.PIQP_SOLVED


class ControlTask(NamedTuple):
    """Task of the robot at this instant.

    Attributes:
        base: (6, 7) cost of a deviation of the base's spatial acceleration (:func:`base_task`).
        feet: (3, 12), in its first row the desired foot accelerations, world axes (:func:`foot_task`).
        legs: (12, 7), N (6 columns) and e with joint accelerations q̈ = N a + e. N a moves no
            foot under a base acceleration a, and e gives these with the base at rest.
        stance: which feet carry load.
    """

    base: FloatArray
    feet: FloatArray
    legs: FloatArray
    stance: Stance


class Solution(NamedTuple):
    """The QP's answer.

    Attributes:
        forces: (12,) ground on feet [N], world axes.
        torque: (12,) torque of the joints [N m].
        base: (6,) predicted spatial acceleration of the base, base axes.
        iterations: number of iterations of the interior-point method; 0 where no limit matters, so that it did not run.
    """

    forces: FloatArray
    torque: FloatArray
    base: FloatArray
    iterations: int


def pyramid(gains: Gains) -> FloatArray:
    """Return (4, 3) rows of ``F f ≤ 0``: |f_x|, |f_y| ≤ μ f_z for one foot."""
    mu = gains.friction
    return np.array([[1.0, 0.0, -mu], [-1.0, 0.0, -mu], [0.0, 1.0, -mu], [0.0, -1.0, -mu]])


class Solver:
    """PIQP's dense interior-point method for problems of one fixed size.

    minimise ½ x'Px + c'x subject to A x = b, h_l ≤ G x ≤ h_u, x_l ≤ x ≤ x_u.
    """

    def __init__(self) -> None:
        self._solver: Any = None

    def reset(self) -> None:
        """Drop the workspace."""
        self._solver = None

    def solve(self, fixed: dict[str, FloatArray], **problem: FloatArray) -> tuple[FloatArray, int] | None:
        """Return (x, iterations), or None when no optimum was found; the next call overwrites x.

        ``fixed`` never changes: PIQP receives it once, and ``problem`` at every call.
        """
        if self._solver is None:
            self._solver = piqp.DenseSolver()
            settings = self._solver.settings
            settings.verbose = False
            settings.preconditioner_iter = 0
            self._solver.setup(**fixed, **problem)
            # Both are live views of the solver's own memory.
            self._x, self._info = self._solver.result.x, self._solver.result.info
        else:
            self._solver.update(**problem)
        if self._solver.solve() != _SOLVED:
            return None
        return self._x, self._info.iter
