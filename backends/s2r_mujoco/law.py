"""How an action becomes controls: scale, offset, limits, gains, and the joints that gains hold beside the policy.

Arrays with a number a joint are in *policy order*, the order of the action's components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_mujoco import joints as joint_order
from s2r_mujoco.arrays import FloatArray, IntArray
from s2r_mujoco.deploy.record import Deployment
from s2r_mujoco.description import Description, PerJoint
from s2r_mujoco.joints import Joints
from s2r_spec.errors import UsageError, one_of, suggest

Drive = Literal["position", "velocity", "torque", "other"]
"""Kind of an actuator: its control is a position, a velocity, a force, or another quantity (a muscle)."""


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
        order: (n,) joint i gets the target of joint order[i]; None where each gets its own.
    """

    def targets(self, action: FloatArray, pose: FloatArray) -> FloatArray:
        """Return (..., n) targets of all joints for (..., k) actions within their limits; (n,) is the default pose."""
        target = self.offset + self.scale * action
        if self.clip_target is not None:
            target = np.clip(target, *self.clip_target)
        if len(self.moved) < pose.size:
            whole = np.broadcast_to(pose, (*action.shape[:-1], pose.size)).copy()
            whole[..., self.moved] = target
            target = whole
        return target if self.order is None else target[..., self.order]

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
    order: IntArray | None = None

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


def law_of(
    model: Any, description: Description, deployment: Deployment, joints: Joints, pose: FloatArray
) -> Law:
    """Return the law of the files; ``pose`` (n,) is the default position of each joint.

    Raises:
        UsageError: a list has another length, or gains do not fit the kind of an actuator.
    """
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
        order=_order(action.order, n, name),
    )


def _order(order: Sequence[int], joints: int, source: str) -> IntArray | None:
    if order and sorted(order) != list(range(joints)):
        raise UsageError(f"{source}: action.order must have each number from 0 to {joints - 1} once")
    return np.array(order, dtype=np.intp) if order else None


def torque_units(model: Any, joints: Joints) -> FloatArray:
    """Return (n,) the joint torque of each actuator at a control of 1: gear times gain [N·m or N]."""
    units: FloatArray = model.actuator_gear[joints.actuators, 0] * model.actuator_gainprm[joints.actuators, 0]
    return units


def servo_gains(model: Any, law: Law, joints: Joints) -> tuple[FloatArray, FloatArray]:
    """Return (n,) kp and kd of the joints: those of the files, or of position actuators; 0 where there is none."""
    if law.pd != "model":
        return law.stiffness, law.damping
    bias, gear = model.actuator_biasprm[joints.actuators], model.actuator_gear[joints.actuators, 0]
    position = np.array([kind == "position" for kind in law.kind])
    kp, kd = -bias[:, 1] * gear**2, -bias[:, 2] * gear**2 + 0.0
    return np.where(position, kp, 0.0), np.where(position, kd, 0.0)


def held_joints(
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
