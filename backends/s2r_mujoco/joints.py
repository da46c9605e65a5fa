"""The joints that a policy acts on: in its own order, each with its place in the model.

Joints are matched by names where the files have names, else by the file's map into the model's actuators. A map is
refused unless the counts agree and the default pose lies within the limits of the joints that it names.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray, IntArray
from s2r_mujoco.deploy.record import Deployment
from s2r_spec.errors import UsageError, one_of, suggest

_SCALAR = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
POSE_SLACK = 1e-3
"""Tolerance: a default angle may exceed a limit by this much [rad or m], since files round their numbers."""


@dataclass(frozen=True)
class Joints:
    """Some hinges and slides of a model; all arrays are (n,).

    Attributes:
        names: names of the joints.
        qpos: indices of their positions.
        dof: indices of their velocities.
        actuators: indices of their actuators; −1 for a joint without one.
        low: lower limits [rad or m]; −inf without one.
        high: upper limits.
    """

    names: tuple[str, ...]
    qpos: IntArray
    dof: IntArray
    actuators: IntArray
    low: FloatArray
    high: FloatArray

    def __len__(self) -> int:
        return len(self.names)


def actuator_of(model: Any) -> dict[int, int]:
    """Return joint → its actuator; a joint with two actuators has the first, and later ones are not driven."""
    kinds = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
    found: dict[int, int] = {}
    for actuator in range(model.nu):
        if int(model.actuator_trntype[actuator]) in kinds:
            found.setdefault(int(model.actuator_trnid[actuator, 0]), actuator)
    return found


def scalar_joints(model: Any) -> list[int]:
    """Return the hinges and slides, in the model's order."""
    return [joint for joint in range(model.njnt) if int(model.jnt_type[joint]) in _SCALAR]


def named(model: Any, joints: Sequence[int]) -> Joints:
    """Return the record of these joints."""
    index = np.array(joints, dtype=np.intp)
    actuators = actuator_of(model)
    limited = model.jnt_limited[index].astype(bool)
    return Joints(
        tuple(name_of(model, joint) for joint in joints),
        model.jnt_qposadr[index].astype(np.intp),
        model.jnt_dofadr[index].astype(np.intp),
        np.array([actuators.get(joint, -1) for joint in joints], dtype=np.intp),
        np.where(limited, model.jnt_range[index, 0], -np.inf),
        np.where(limited, model.jnt_range[index, 1], np.inf),
    )


def name_of(model: Any, joint: int) -> str:
    """Return the name of a joint, or ``joint 3`` for one without a name."""
    return str(model.joint(joint).name) or f"joint {joint}"


def driven(model: Any) -> list[int]:
    """Return the joints with an actuator, in the order of the actuators."""
    return list(actuator_of(model))


def by_names(model: Any, wanted: Sequence[str], source: str, remedy: str = "") -> list[int]:
    """Return the joints of these names; ``remedy`` ends the message about a name that the model lacks.

    Raises:
        UsageError: a name is not that of a hinge or a slide, or stands twice.
    """
    known = {name_of(model, joint): joint for joint in scalar_joints(model)}
    for name in wanted:
        if name not in known:
            raise UsageError(
                f"{source}: the model has no joint {name!r}{suggest(name, known)} it has {one_of(known)}{remedy}"
            )
    if len(set(wanted)) < len(wanted):
        twice = next(name for name in wanted if list(wanted).count(name) > 1)
        raise UsageError(f"{source}: the joint {twice!r} stands twice in the list of joints")
    return [known[name] for name in wanted]


def matches(pattern: str, name: str, source: str) -> bool:
    """Return whether a regular expression fits a whole name; a UsageError if it is none."""
    try:
        return re.fullmatch(pattern, name) is not None
    except re.error as error:
        raise UsageError(f"{source}: {pattern!r} is not a regular expression: {error}") from None


def by_patterns(model: Any, patterns: Sequence[str], source: str) -> list[int]:
    """Return the joints whose names fit one of the regular expressions, in the model's order.

    Raises:
        UsageError: an expression fits no joint.
    """
    known = {name_of(model, joint): joint for joint in scalar_joints(model)}
    for pattern in patterns:
        if not any(matches(pattern, name, source) for name in known):
            raise UsageError(
                f"{source}: the model has no joint {pattern!r}{suggest(pattern, known)} it has {one_of(known)}"
            )
    return [joint for name, joint in known.items() if any(matches(one, name, source) for one in patterns)]


def by_map(model: Any, deployment: Deployment) -> list[int]:
    """Return the joints of a deploy file without names: policy joint i has the motor, or actuator, ``motors[i]``.

    Raises:
        UsageError: the counts do not agree.
    """
    joints = driven(model)
    try:
        return [joints[actuator] for actuator in deployment.actuators(len(joints))]
    except ValueError as error:
        raise UsageError(
            f"{error}; the file is of another robot, or list its joints in `action.joints`"
        ) from None


def of_file(model: Any, deployment: Deployment, source: str) -> list[int]:
    """Return the joints of a deploy file with names.

    A name that the model lacks is that of another version of the robot. Its motor tells the joint, if most
    names of the file are in the model, each at its motor.

    Raises:
        UsageError: the model lacks a name, and the motors do not tell its joint.
    """
    known = {name_of(model, joint): joint for joint in scalar_joints(model)}
    named = [known.get(name) for name in deployment.joints]
    try:
        motors = by_map(model, deployment)
    except UsageError:
        motors = []
    fits = [one == other for one, other in zip(named, motors, strict=False) if one is not None]
    if None in named and all(fits) and 2 * len(fits) > len(named):
        return motors
    remedy = "; if it is the same robot with other names, list them in `action.joints` of " + source
    if motors:
        names = ", ".join(f'"{name_of(model, joint)}"' for joint in motors)
        remedy = (
            f"; if its motors are the actuators in their order, write action.joints = [{names}] in {source}"
        )
    return by_names(model, deployment.joints, deployment.source, remedy)


def refuse_unfit(
    joints: Joints,
    pose: FloatArray,
    source: str,
    remedy: str = "the order of the joints, or the robot, is another",
) -> None:
    """Refuse a pose outside the limits of the joints; ``remedy`` ends the message.

    Raises:
        UsageError: an angle is outside its joint's limits.
    """
    for name, low, value, high in zip(joints.names, joints.low, pose, joints.high, strict=True):
        if not low - POSE_SLACK <= value <= high + POSE_SLACK:
            raise UsageError(
                f"{source}: the position {value:g} of the joint {name} is outside its limits "
                f"[{low:.4g}, {high:.4g}] in the model; {remedy}"
            )
