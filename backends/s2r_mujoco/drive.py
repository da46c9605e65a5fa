"""From targets to the controls of the actuators, at every physics step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.law import torque_units
from s2r_mujoco.plan import Plan

Apply = Callable[[FloatArray], None]
"""Writes the controls for a target, (n,) in policy order."""


def prepare_actuators(model: Any, plan: Plan) -> None:
    """Put the gains of the files into the actuators: those of position actuators, and implicit ones of torques.

    An actuator with the gear g has the length g q and the joint torque g F. With F = kp/g (target − q) − kd/g q̇ the
    torque is that of the gains. A joint with a velocity target is held at its default position: its control is the
    velocity, and F = kd/g (target − q̇) + kp/g (pose − q). A test may scale all of them by the
    strength of a motor.
    """
    law = plan.law
    _hold(model, plan)
    if law.pd == "model":
        return
    strength = torque_units(model, plan.joints) / law.unit
    for i, actuator in enumerate(plan.joints.actuators):
        if law.kind[i] == "torque" and law.pd == "explicit":
            continue
        kp, kd = strength[i] * law.stiffness[i], strength[i] * law.damping[i]
        _servo(model, actuator, kp, kd)
        if law.speed[i]:
            gear = model.actuator_gear[actuator, 0]
            model.actuator_ctrllimited[actuator] = 0  # the limits are those of a position
            model.actuator_gainprm[actuator, 0] = kd / gear
            model.actuator_biasprm[actuator, 0] = kp * plan.pose[i] / gear
        if np.isfinite(law.torque_limit[i]) and not model.actuator_forcelimited[actuator]:
            gear = abs(model.actuator_gear[actuator, 0])
            model.actuator_forcelimited[actuator] = 1
            model.actuator_forcerange[actuator] = np.array([-1.0, 1.0]) * law.torque_limit[i] / gear
    if law.pd == "implicit" and model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def _hold(model: Any, plan: Plan) -> None:
    """Turn the actuators of held joints into position actuators.

    Their damping becomes that of the joints, which every integrator of MuJoCo treats implicitly: light joints stay
    stable, and the integrator need not change.
    """
    held = plan.held
    for actuator, stiffness in zip(held.joints.actuators, held.stiffness, strict=True):
        _servo(model, actuator, stiffness, 0.0)
    model.dof_damping[held.joints.dof] += held.damping


def _servo(model: Any, actuator: int, stiffness: float, damping: float) -> None:
    """Turn an actuator of torques or positions into one of positions with these gains."""
    gear = model.actuator_gear[actuator, 0]
    if model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE:
        _limit_force(model, actuator)
    model.actuator_gainprm[actuator, 0] = stiffness / gear
    model.actuator_biastype[actuator] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_biasprm[actuator, :3] = 0.0, -stiffness / gear**2, -damping / gear**2


def _limit_force(model: Any, actuator: int) -> None:
    """Turn the limits of a torque actuator's control into limits of its force, since the control becomes a position."""
    if model.actuator_ctrllimited[actuator]:
        limits = model.actuator_ctrlrange[actuator] * model.actuator_gainprm[actuator, 0]
        if model.actuator_forcelimited[actuator]:
            low, high = model.actuator_forcerange[actuator]
            limits = np.array([max(limits.min(), low), min(limits.max(), high)])
        model.actuator_forcerange[actuator] = np.sort(limits)
        model.actuator_forcelimited[actuator] = 1
        model.actuator_ctrllimited[actuator] = 0


def writer(model: Any, data: Any, plan: Plan) -> tuple[Apply, bool]:
    """Return the function that writes the controls, and whether it must run at every physics step."""
    law, joints, control = plan.law, plan.joints, data.ctrl
    actuators = joints.actuators
    if law.pd != "explicit" or "torque" not in law.kind:

        def hold(target: FloatArray) -> None:
            control[actuators] = target

        return hold, False
    positions, velocities, kp, kd, limit = data.qpos, data.qvel, law.stiffness, law.damping, law.torque_limit
    # A position actuator beside torque actuators keeps its target as control.
    torque = np.array([one == "torque" for one in law.kind])
    limited, mixed, plain = bool(np.isfinite(limit).any()), not torque.all(), bool((law.unit == 1.0).all())
    speed, pose = law.speed, plan.pose
    rolls = bool(speed.any())

    def proportional_derivative(target: FloatArray) -> None:
        if rolls:
            still = np.where(speed, pose, target)
            force = kp * (still - positions[joints.qpos]) + kd * (
                np.where(speed, target, 0.0) - velocities[joints.dof]
            )
        else:
            force = kp * (target - positions[joints.qpos]) - kd * velocities[joints.dof]
        if limited:
            force = np.clip(force, -limit, limit)
        if not plain:
            force = force / law.unit
        control[actuators] = np.where(torque, force, target) if mixed else force

    return proportional_derivative, True
