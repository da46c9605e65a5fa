"""The controller's rigid-body model in Pinocchio, built from the same constants as the plant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from s2r_sim.robot.constants import LEGS, Inertia, Robot

FEET = tuple(f"{leg.name}_foot" for leg in LEGS)


def build(robot: Robot, rotor_inertia: float = 0.0) -> Any:
    """Return the ``pin.Model``: free-flyer and twelve joints, legs FR, FL, RR, RL, a frame per foot.

    Joints are added in that order (a URDF would be sorted by name), so that no
    vector needs a permutation. ``rotor_inertia`` [kg m²] is added to the
    mass matrix of every joint.
    """
    model = pin.Model()
    model.name = "a1"
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    model.appendBodyToJoint(base, _inertia(robot.base), pin.SE3.Identity())
    for leg in LEGS:
        parent = base
        for part, inertia, placement in robot.links(leg):
            kind = pin.JointModelRX() if part == "hip" else pin.JointModelRY()
            parent = model.addJoint(parent, kind, _shift(placement), f"{leg.name}_{part}_joint")
            model.appendBodyToJoint(parent, _inertia(inertia), pin.SE3.Identity())
        model.addFrame(
            pin.Frame(f"{leg.name}_foot", parent, _shift(robot.foot_offset), pin.FrameType.OP_FRAME)
        )
    model.armature = np.array([0.0] * 6 + [rotor_inertia] * (model.nv - 6))
    return model


def _inertia(inertia: Inertia) -> Any:
    return pin.Inertia(inertia.mass, np.array(inertia.com), inertia.tensor)


def _shift(offset: tuple[float, float, float]) -> Any:
    return pin.SE3(np.eye(3), np.array(offset))
