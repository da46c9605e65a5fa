"""The plan of a rollout: robot file, deploy file and model put together, with every key resolved.

A key of the robot file wins over the deploy file, and the deploy file over the model. Arrays with a number a joint are
in *policy order*, the order of the action's components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_mujoco import joints as joint_order
from s2r_mujoco.arrays import FloatArray, IntArray
from s2r_mujoco.deploy.record import Deployment, Term
from s2r_mujoco.description import COMMANDS, CommandTable, Description, PerJoint
from s2r_mujoco.joints import Joints
from s2r_spec.errors import UsageError, one_of, suggest

Drive = Literal["position", "velocity", "torque", "other"]
"""Kind of an actuator: its control is a position, a velocity, a force, or another quantity (a muscle)."""
WHOLE = 1e-6
"""Tolerance: relative difference between a control period and a whole number of physics steps."""


@dataclass(frozen=True)
class Law:
    """From an action to the controls of the actuators; arrays (n,) in policy order, for (k,) components of an action.

    Attributes:
        scale: (k,) of the action.
        offset: (k,) target at a zero action [rad or m; 0 for an actuator without a position].
        moved: (k,) joints that the k components of an action move; the others stay at the default pose.
        clip_action: limits of the policy's output; None for none.
        clip_target: limits of the targets; None for none.
        speed: (n,) whether the target is a velocity; its position target stays at the default pose.
        kind: kind of each actuator in the model.
        pd: ``model`` if the actuators' own law applies, ``explicit`` for torques from gains at every physics step, or
            ``implicit`` for gains inside of MuJoCo.
        stiffness: kp [N·m/rad or N/m].
        damping: kd [N·m·s/rad or N·s/m].
        torque_limit: largest torque [N·m]; inf without one.
        unit: joint torque at a control of 1, in the model's file [N·m]. A test that changes a gear or a gain makes a
            motor stronger or weaker than the controller assumes.
    """

    scale: FloatArray
    offset: FloatArray
    moved: IntArray
    clip_action: tuple[FloatArray, FloatArray] | None
    clip_target: tuple[FloatArray, FloatArray] | None
    speed: NDArray[np.bool_]
    kind: tuple[Drive, ...]
    pd: Literal["model", "explicit", "implicit"]
    stiffness: FloatArray
    damping: FloatArray
    torque_limit: FloatArray
    unit: FloatArray

    @property
    def has_target(self) -> NDArray[np.bool_]:
        """(n,) whether the action moves a target position; else it is a force, or another quantity."""
        return np.array([self.pd != "model" or kind == "position" for kind in self.kind], dtype=np.bool_)


@dataclass(frozen=True)
class Held:
    """Joints that the policy does not move and that gains hold at one position; arrays are (n,)."""

    joints: Joints
    pose: FloatArray
    stiffness: FloatArray
    damping: FloatArray


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
        law=_law(model, description, deployment, joints, pose),
        held=_held(model, description, deployment, joints, home),
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


def kind_of(model: Any, actuator: int) -> Drive:
    """Return the kind of an actuator, from its gain and bias."""
    fixed = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
    dynamics, bias = model.actuator_dyntype[actuator], model.actuator_biastype[actuator]
    filters = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
    if fixed and dynamics == mujoco.mjtDyn.mjDYN_NONE and bias == mujoco.mjtBias.mjBIAS_NONE:
        return "torque"
    affine = bias == mujoco.mjtBias.mjBIAS_AFFINE
    if fixed and affine and dynamics == mujoco.mjtDyn.mjDYN_NONE and model.actuator_biasprm[actuator, 1] == 0:
        return "velocity"
    position = affine and model.actuator_biasprm[actuator, 1] < 0
    if fixed and position and any(dynamics == one for one in (mujoco.mjtDyn.mjDYN_NONE, *filters)):
        return "position"
    return "other"


def _law(
    model: Any, description: Description, deployment: Deployment, joints: Joints, pose: FloatArray
) -> Law:
    action, name, n = description.table.action, description.path.name, len(joints)
    kind = tuple(kind_of(model, int(actuator)) for actuator in joints.actuators)
    stiffness = spread(action.stiffness or deployment.stiffness, joints.names, f"{name}: action.stiffness")
    if stiffness is None and (action.damping or action.pd):
        raise UsageError(
            f"{name}: action.{'damping' if action.damping else 'pd'} needs action.stiffness, and no file states it"
        )
    damping = spread(action.damping or deployment.damping, joints.names, f"{name}: action.damping")
    moved = np.array(deployment.action_joints or range(n), dtype=np.intp)
    names = [joints.names[i] for i in moved]
    speed = np.isin(np.arange(n), deployment.velocity_joints)
    for i in range(n) if stiffness is not None else ():
        if kind[i] == "other" or (kind[i] == "velocity" and not speed[i]):
            raise UsageError(
                f"{name}: gains of {joints.names[i]} need a position or a torque actuator, and its own is neither"
            )
    position = np.array([stiffness is not None or one == "position" for one in kind], dtype=np.bool_) & ~speed
    scale = spread(action.scale or deployment.action_scale or (1.0,), names, f"{name}: action.scale")
    offset = spread(action.offset or deployment.action_offset, names, f"{name}: action.offset")
    limit = spread(deployment.torque_limit, joints.names, f"{deployment.source}: torque limits")
    clip = _clip(deployment.action_clip, names, deployment.source)
    own = _clip((action.clip,) if action.clip else (), names, name)
    assert scale is not None
    return Law(
        scale=scale,
        offset=np.where(position, pose, 0.0)[moved] if offset is None else offset,
        moved=moved,
        clip_action=clip if deployment.action_clip_first else None,
        clip_target=own or (None if deployment.action_clip_first else clip),
        speed=speed,
        kind=kind,
        pd="model" if stiffness is None else action.pd or "explicit",
        stiffness=np.zeros(n) if stiffness is None else stiffness,
        damping=np.zeros(n) if damping is None else damping,
        torque_limit=np.full(n, np.inf) if limit is None else limit,
        unit=torque_units(model, joints),
    )


def torque_units(model: Any, joints: Joints) -> FloatArray:
    """Return (n,) the joint torque of each actuator at a control of 1: gear times gain [N·m or N]."""
    units: FloatArray = model.actuator_gear[joints.actuators, 0] * model.actuator_gainprm[joints.actuators, 0]
    return units


def _held(
    model: Any, description: Description, deployment: Deployment, joints: Joints, home: FloatArray
) -> Held:
    """Return the joints that the deploy file or the robot file holds; a key of the robot file wins."""
    driven, source = joint_order.driven(model), f"{description.path.name}: action.hold"
    found = {driven[motor]: values for motor, values in deployment.held.items() if motor < len(driven)}
    for pattern, gains in description.table.action.hold.items():
        for joint in joint_order.by_patterns(model, (pattern,), source):
            found[joint] = (float(home[model.jnt_qposadr[joint]]), *gains)
    moved = {*joints.qpos.tolist()}
    chosen = [one for one in driven if one in found and model.jnt_qposadr[one] not in moved]
    held, rows = joint_order.named(model, chosen), [found[one] for one in chosen]
    for name, actuator in zip(held.names, held.actuators, strict=True):
        if kind_of(model, int(actuator)) not in ("torque", "position"):
            raise UsageError(f"{source}: the actuator of {name} is neither a torque nor a position actuator")
    return Held(held, *np.array(rows, dtype=np.float64).reshape(-1, 3).T)


def _clip(
    pairs: Sequence[tuple[float, float]], names: Sequence[str], source: str
) -> tuple[FloatArray, FloatArray] | None:
    if not pairs:
        return None
    low, high = (
        spread(tuple(one[side] for one in pairs), names, f"{source}: the action's clip") for side in (0, 1)
    )
    assert low is not None
    assert high is not None
    return low, high


def spread(values: PerJoint, names: Sequence[str], source: str) -> FloatArray | None:
    """Return (n,) values of joints from one number, one a joint, or a table by regular expressions; None from none.

    Raises:
        UsageError: there is another number of values, or a joint has no value or two.
    """
    if not values:
        return None
    if isinstance(values, Mapping):
        for pattern in values:
            if not any(joint_order.matches(pattern, name, source) for name in names):
                raise UsageError(
                    f"{source}: the policy moves no joint {pattern!r}{suggest(pattern, names)} it moves {one_of(names)}"
                )
        return np.array([_value(values, name, source) for name in names])
    if len(values) not in (1, len(names)):
        raise UsageError(f"{source} has {len(values)} numbers, but the policy moves {len(names)} joints")
    return np.full(len(names), values[0]) if len(values) == 1 else np.array(values, dtype=np.float64)


def _value(values: Mapping[str, float], name: str, source: str) -> float:
    fitting = [pattern for pattern in values if joint_order.matches(pattern, name, source)]
    if len(fitting) != 1:
        found = " and ".join(map(repr, fitting)) or "no key"
        raise UsageError(f"{source}: {found} fits the joint {name}; exactly one key must fit each joint")
    return values[fitting[0]]
