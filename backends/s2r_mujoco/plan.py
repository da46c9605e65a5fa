"""The plan of a rollout: robot file, deploy file and model put together, with every key resolved.

A key of the robot file wins over the deploy file, and the deploy file over the model. Arrays with a number a joint are
in *policy order*, the order of the action's components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco import joints as joint_order
from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.deploy.record import Deployment, Term
from s2r_mujoco.description import COMMANDS, CommandTable, Description
from s2r_mujoco.joints import Joints
from s2r_mujoco.law import Held, Law, held_joints, law_of, spread
from s2r_spec.errors import UsageError, one_of, suggest

WHOLE = 1e-6
"""Tolerance: relative difference between a control period and a whole number of physics steps."""


@dataclass(frozen=True)
class Plan:
    """Everything that a rollout does, besides the test and the seed.

    Attributes:
        joints: the joints of the policy.
        home: (nq,) default configuration of the model.
        pose: (n,) default position of each joint of the policy.
        terms: the terms of the observation.
        history_by: ``term`` or ``time``, the outer order of an observation with history.
        history_start: ``first`` or ``zero``, with which a history is filled at t = 0.
        observation_clip: limits of the whole observation.
        law: from an action to the actuators.
        held: the joints that gains hold beside the policy.
        commands: component of the velocity command → its table.
        ranges: component → range that the deploy file states.
        root: body with the free joint; −1 for a fixed base.
        decimation: physics steps a control step.
        step: control period [s].
        key: number of the keyframe; −1 for none.
    """

    joints: Joints
    home: FloatArray
    pose: FloatArray
    terms: tuple[Term, ...]
    history_by: str
    history_start: str
    observation_clip: tuple[float, float] | None
    law: Law
    held: Held
    commands: Mapping[str, CommandTable]
    ranges: Mapping[str, tuple[float, float]]
    root: int
    decimation: int
    step: float
    key: int


def make_plan(description: Description, deployment: Deployment, model: Any) -> Plan:
    """Put the three together; ``model`` is the compiled model with nominal fields.

    Raises:
        UsageError: the files contradict each other, or lack something that a rollout needs.
    """
    table, name = description.table, description.path.name
    default = table.default_joint_pos or deployment.joint_pos
    key = _keyframe(model, table.keyframe, name, bool(default))
    joints = _joints(model, table.action.joints, deployment, name)
    source = f"{name}: default_joint_pos" if table.default_joint_pos else deployment.source
    stated = spread(default, joints.names, source)
    home = _home(model, joints, stated, key)
    pose = home[joints.qpos]
    if stated is not None:
        joint_order.refuse_unfit(joints, pose, source)
    decimation, step = _period(table.decimation, deployment.step, float(model.opt.timestep), name)
    return Plan(
        joints=joints,
        home=home,
        pose=pose,
        terms=_terms(description, deployment),
        history_by=table.history_by or deployment.history_by,
        history_start=deployment.history_start,
        observation_clip=table.observation_clip or deployment.observation_clip,
        law=law_of(model, description, deployment, joints, pose),
        held=held_joints(model, description, deployment, joints, home),
        commands=_commands(description),
        ranges=deployment.command_ranges,
        root=_root(model, table.root, name),
        decimation=decimation,
        step=step,
        key=key,
    )


def _keyframe(model: Any, wanted: str, source: str, has_default: bool) -> int:
    names = [model.key(number).name for number in range(model.nkey)]
    if wanted and wanted not in names:
        raise UsageError(
            f"{source}: the model has no keyframe {wanted!r}{suggest(wanted, names)} "
            f"it has {one_of(filter(None, names))}"
        )
    if wanted:
        return names.index(wanted)
    if has_default or not names:
        return -1
    if "home" in names or len(names) == 1:
        return names.index("home") if "home" in names else 0
    known = f"name one of {one_of(filter(None, names))}" if any(names) else "give one a name in the XML file"
    raise UsageError(f"{source}: the model has {len(names)} keyframes; {known}, and write it in `keyframe`")


def _joints(model: Any, wanted: Sequence[str], deployment: Deployment, source: str) -> Joints:
    if model.nu == 0:
        raise UsageError(
            f"{source}: the model has no actuators; write motors = true for a torque motor at each joint, or add "
            f"<actuator> elements to its XML file"
        )
    if wanted:
        found = joint_order.by_names(model, wanted, f"{source}: action.joints")
    elif deployment.joints:
        found = joint_order.of_file(model, deployment, source)
    elif deployment.motors or deployment.held:
        found = joint_order.by_map(model, deployment)
    else:
        found = joint_order.driven(model)
    joints = joint_order.named(model, found)
    if deployment.joint_pos and len(deployment.joint_pos) != len(joints):
        if wanted:
            raise UsageError(
                f"{source}: action.joints has {len(joints)} joints instead of {len(deployment.joint_pos)}, one a "
                f"default position of {deployment.source}, in its order"
            )
        raise UsageError(
            f"{deployment.source}: it has default positions of {len(deployment.joint_pos)} joints, and the model has "
            f"{len(joints)} actuators; the file is of another robot, or list its joints in `action.joints`"
        )
    without = [name for name, actuator in zip(joints.names, joints.actuators, strict=True) if actuator < 0]
    if without:
        raise UsageError(
            f"{source}: no actuator drives the joint {without[0]}; leave it out of `action.joints`"
        )
    return joints


def _home(model: Any, joints: Joints, stated: FloatArray | None, key: int) -> FloatArray:
    """Return (nq,) the default configuration: that of the files for the joints of the policy, else of the model."""
    home = np.array(model.qpos0 if key < 0 else model.key_qpos[key], dtype=np.float64)
    if stated is not None:
        home[joints.qpos] = stated
    return home


def _period(decimation: int | None, step: float | None, timestep: float, source: str) -> tuple[int, float]:
    if decimation is None:
        if step is None:
            raise UsageError(
                f"{source}: no file states the control period; write `decimation`, the physics steps of "
                f"{1e3 * timestep:g} ms in a control step"
            )
        decimation = max(1, round(step / timestep))
        if abs(decimation * timestep - step) > WHOLE * step:
            raise UsageError(
                f"{source}: the control period of {1e3 * step:g} ms is not a whole number of physics steps of "
                f"{1e3 * timestep:g} ms; write another `timestep`"
            )
    return decimation, decimation * timestep


def _root(model: Any, wanted: str, source: str) -> int:
    """Return the body with a free joint under which most actuators are, the wanted one, or −1 for a fixed base."""
    free = [
        int(model.jnt_bodyid[joint])
        for joint in range(model.njnt)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    ]
    if wanted:
        names = [model.body(body).name for body in free]
        if wanted not in names:
            raise UsageError(
                f"{source}: root = {wanted!r} is not a body with a free joint; such bodies: {one_of(names)}"
            )
        return free[names.index(wanted)]
    driven = _driven_roots(model)
    root = max(free, key=driven.count, default=-1)
    return -1 if driven and root not in driven else root


def _driven_roots(model: Any) -> list[int]:
    """Return the body below the world under which each actuator of a joint, a site or a body is."""
    body_of = {
        int(mujoco.mjtTrn.mjTRN_JOINT): model.jnt_bodyid,
        int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): model.jnt_bodyid,
        int(mujoco.mjtTrn.mjTRN_SITE): model.site_bodyid,
        int(mujoco.mjtTrn.mjTRN_BODY): np.arange(model.nbody),
    }
    kinds = zip(model.actuator_trntype.tolist(), model.actuator_trnid[:, 0], strict=True)
    return [int(model.body_rootid[body_of[kind][target]]) for kind, target in kinds if kind in body_of]


def _commands(description: Description) -> dict[str, CommandTable]:
    given = description.commands
    return {name: given.get(name, CommandTable()) for name in COMMANDS}


def _terms(description: Description, deployment: Deployment) -> tuple[Term, ...]:
    """Return the terms of the robot file, or else of the deploy file.

    Raises:
        UsageError: the policy of the deploy file has several inputs.
    """
    for term in deployment.terms:
        if term.group and not description.terms:
            raise UsageError(
                f"{term.source}: the policy has the input {term.group!r} beside others; "
                f"s2r runs policies with one input"
            )
    return tuple(
        replace(term, scale=deployment.command_scale)
        if term.name == "velocity_commands" and not term.scale and description.terms
        else term
        for term in description.terms or deployment.terms
    )
