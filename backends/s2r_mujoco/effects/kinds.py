"""Kinds of joints: those of the same name on several sides of a robot, such as all knees; and the scale of each."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray, IntArray
from s2r_mujoco.joints import actuator_of, name_of, scalar_joints
from s2r_mujoco.plan import Plan

_PAIRS = [one + two for one in "frhlb" for two in "frhlb"]
SIDES = frozenset(["left", "right", "front", "rear", "hind", "back", "joint", *"lrfhb", *_PAIRS])
"""Definition: parts of a joint's name that say where on a robot it is."""
KINDS = 4
"""Budget: most kinds of joints with sizes of their own; of more, all joints share one, in parts of their scales."""
ACCELERATION = 10.0
"""Definition: turns that a joint without a limit gains in a second, for the scale of its torque [1/s²]."""


@dataclass(frozen=True)
class Kind:
    """Joints that share a size.

    Attributes:
        name: of the kind, as a parameter of an effect has it.
        joints, dof: numbers of the joints, and of their degrees of freedom.
        actuators: of these joints; those without one are left out.
        slides: whether they slide.
        sides: where each joint is, such as ``fl``; empty where two joints are at one place, or there is one joint.
    """

    name: str
    joints: IntArray
    dof: IntArray
    actuators: IntArray
    slides: bool
    sides: tuple[str, ...] = ()


def side_name(name: str) -> str:
    """Return the parts of a joint's name that say where it is; ``FL_hip_joint`` → ``fl``."""
    return "_".join(word for word in _words(name) if word in SIDES and word != "joint")


def kind_name(name: str) -> str:
    """Return the name of a joint without the parts that say where it is; ``FL_hip_joint`` → ``hip``."""
    kept = [word for word in _words(name) if word not in SIDES] or ["joint"]
    return re.sub(r"\W", "_", "_".join(filter(None, kept)))


def _words(name: str) -> list[str]:
    return re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).replace("-", "_").replace(".", "_").lower().split("_")


def kinds_of(model: Any, own: Mapping[str, Sequence[int]] | None = None) -> list[Kind]:
    """Return the kinds of joints, in the model's order; one for all hinges where there are too many.

    ``own`` has joints of kinds that the user made, by name; they come first.
    """
    given = [_kind(model, name, joints, _slides(model, joints[0])) for name, joints in (own or {}).items()]
    taken = {joint for kind in given for joint in kind.joints.tolist()}
    groups: dict[tuple[str, bool], list[int]] = {}
    for joint in (one for one in scalar_joints(model) if one not in taken):
        groups.setdefault((kind_name(name_of(model, joint)), _slides(model, joint)), []).append(joint)
    if len(groups) > KINDS:
        every = {
            slides: [j for (_, s), own in groups.items() if s == slides for j in own]
            for slides in (False, True)
        }
        groups = {
            ("slides" if slides else "hinges", slides): sorted(own) for slides, own in every.items() if own
        }
    return [*given, *(_kind(model, name, joints, slides) for (name, slides), joints in groups.items())]


def _slides(model: Any, joint: int) -> bool:
    return int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_SLIDE)


def _kind(model: Any, name: str, joints: Sequence[int], slides: bool) -> Kind:
    of_joint, index = actuator_of(model), np.array(joints, dtype=np.intp)
    actuators = np.array([of_joint[j] for j in joints if j in of_joint], dtype=np.intp)
    sides = tuple(side_name(name_of(model, j)) for j in joints)
    apart = len(set(sides)) == len(sides) > 1 and all(sides)
    return Kind(
        name, index, model.jnt_dofadr[index].astype(np.intp), actuators, slides, sides if apart else ()
    )


def at_rest(model: Any, pose: FloatArray) -> tuple[Any, FloatArray]:
    """Return the data of a model at rest in a pose (nq,), and its mass matrix (nv, nv)."""
    data, matrix = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, matrix)
    return data, matrix


def scales_of(model: Any, plan: Plan, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (nv,) inertia of every degree of freedom at a pose, and its torque [N·m or N].

    The torque is the limit of its motor. Without a limit it is that of its weight at the pose, or of a quick start.
    """
    data, matrix = at_rest(model, pose)
    inertia = np.diag(matrix).copy()
    torque = np.maximum(np.abs(data.qfrc_bias), 2.0 * np.pi * ACCELERATION * inertia)
    for joint, actuator in actuator_of(model).items():
        limits = _limits(model, actuator, joint)
        own = np.flatnonzero(plan.joints.actuators == actuator)
        limits += plan.law.torque_limit[own].tolist()
        finite = [limit for limit in limits if np.isfinite(limit) and limit > 0.0]
        if finite:
            torque[model.jnt_dofadr[joint]] = min(finite)
    return inertia, torque


def _limits(model: Any, actuator: int, joint: int) -> list[float]:
    """Return the limits that a model states of the torque of a joint."""
    gear, found = abs(float(model.actuator_gear[actuator, 0])), []
    if model.actuator_forcelimited[actuator]:
        found.append(gear * float(np.abs(model.actuator_forcerange[actuator]).max()))
    if model.jnt_actfrclimited[joint]:
        found.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    if (
        model.actuator_ctrllimited[actuator]
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    ):
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        found.append(gear * gain * float(np.abs(model.actuator_ctrlrange[actuator]).max()))
    return found
