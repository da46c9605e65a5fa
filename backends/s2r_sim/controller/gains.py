"""Every gain of the controller, in one table, and its options."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from s2r_sim.robot.constants import Vector3

RATE = 500
"""Control ticks per second; one tick is 2 ms."""
Form = Literal["condensed", "full"]
"""Unknowns of the QP: the forces of the stance feet, or all 30 accelerations and forces."""
Feedback = Literal["truth", "estimate"]
"""Base position and velocity for the controller: the true ones under noise, or its own estimate."""


@dataclass(frozen=True)
class Gains:
    """Gait, foothold, tasks, force distribution, joint level and failure handling.

    Base tasks act on (forward, left, up) in the heading frame and on
    (roll, pitch, yaw). There is no integral action. It would overshoot, and it
    would hide steady disturbances, which make up a sim-to-real gap.
    ``kd_linear[0]`` sets the velocity offset under an unknown horizontal force
    (offset = acceleration / kd).
    """

    period: float = 0.40
    """[s] period of the trot; FR with RL, then FL with RR."""
    duty: float = 0.55
    """Fraction of the period for which a foot is on the ground."""
    swing_height: float = 0.06
    """[m] above the line from lift-off to touch-down."""
    touch_down_depth: float = 0.002
    """[m] depth below the ground at which a swing ends; a margin above it would cost forward speed."""
    base_height: float = 0.28
    """[m] height of the base origin above the stance feet's contact points."""
    raibert: float = 0.10
    """[s] foothold shift per velocity error."""

    kp_linear: Vector3 = (0.0, 20.0, 120.0)
    kd_linear: Vector3 = (8.0, 10.0, 18.0)
    kp_angular: Vector3 = (150.0, 150.0, 80.0)
    kd_angular: Vector3 = (20.0, 20.0, 16.0)
    weight_linear: Vector3 = (50.0, 10.0, 20.0)
    weight_angular: Vector3 = (10.0, 10.0, 5.0)

    stance_damping: float = 20.0
    """[1/s] damping of stance feet: desired acceleration = −20 · velocity."""
    kp_swing: float = 500.0
    kd_swing: float = 40.0
    weight_swing: float = 1.0
    weight_force: float = 1e-3
    """Weight of the stance forces' deviation from equal shares of the robot's weight."""
    weight_acceleration: float = 1e-4

    friction: float = 0.5
    """Friction coefficient of the QP's pyramid; below the plant's 0.8."""
    min_force: float = 2.0
    max_force: float = 200.0
    """[N] vertical force of a stance foot."""

    kp_joint_swing: float = 20.0
    kd_joint: float = 0.8
    max_joint_step: float = 0.3
    """[rad] bound on q_des − q."""

    rotor_inertia: float = 0.005
    """[kg m²] inertia of every motor in the controller's model, seen at the joint."""

    hold_ticks: int = 5
    """Largest number of failed QPs in a row that the last good forces bridge; then the joints brake."""
    kd_damping: float = 3.0

    @cached_property
    def base(self) -> NDArray[np.float64]:
        """(6, 3) kp, kd and the weights' square roots of the linear base task, and the same of the angular one."""
        linear = (self.kp_linear, self.kd_linear, np.sqrt(self.weight_linear))
        return np.array([*linear, self.kp_angular, self.kd_angular, np.sqrt(self.weight_angular)])

    @cached_property
    def swing(self) -> tuple[float, float, float, float, float, float]:
        """The gains of :func:`s2r_sim.controller.foot_task.foot_task`."""
        return (
            self.kp_swing,
            self.kd_swing,
            self.stance_damping,
            self.swing_height,
            self.touch_down_depth,
            self.raibert,
        )
