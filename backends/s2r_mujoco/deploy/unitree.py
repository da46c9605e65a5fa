"""Read deploy.yaml of unitree_rl_lab and unitree_rl_mjlab.

The file has two orders. ``stiffness`` and ``damping`` are in motor order; all else is in policy order, and policy
joint i is motor ``joint_ids_map[i]``. Terms are those of Isaac Lab: clipped, then scaled, each with its history,
oldest first. Source: the controllers of both repositories, deploy/include/isaaclab.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

from s2r_mujoco.deploy.record import MOST_HISTORY, Deployment, Term, ranks
from s2r_mujoco.deploy.section import Section, is_number, shown
from s2r_mujoco.deploy.yaml import Tagged
from s2r_spec.errors import UsageError, one_of

VECTORS = {"base_lin_vel", "base_ang_vel", "projected_gravity", "velocity_commands"}
"""Definition: terms of three components."""
JOINTS = {"joint_pos_rel", "joint_pos", "joint_vel_rel", "joint_vel"}
"""Definition: terms of one component a joint."""
OTHER_NAMES = {
    "keyboard_velocity_commands": "velocity_commands",
    "generated_commands": "velocity_commands",
    "gait_phase": "phase",
}
"""Definition: names of the field for terms that have another name here."""
ACTIONS = ("JointPositionAction", "JointVelocityAction")
"""Definition: actions that Unitree's controllers know."""
RANGES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
"""Definition: components of a velocity command."""
_TERM_KEYS = {"params", "scale", "clip", "history_length"}
_SLICE = "python/object/apply:builtins.slice"
_JOINTS = "one a joint by joint_ids_map"
_MOVED = "one a joint that the action moves"


def fits(values: Mapping[str, object]) -> bool:
    """Return whether these are the keys of a deploy.yaml."""
    return {"joint_ids_map", "observations"} <= values.keys()


def deployment(values: Mapping[str, object], path: Path) -> Deployment:
    """Return what a deploy.yaml says.

    Raises:
        UsageError: a key is missing, or a list has another length than the joints of ``joint_ids_map``.
    """
    file = Section(values, path.name)
    motors = file.indices("joint_ids_map")
    if not motors:
        file.fail("joint_ids_map", "is empty; it must have the motor of each joint of the policy")
    count, step = len(motors), file.number("step_dt", positive=True)
    default = file.numbers("default_joint_pos", count, _JOINTS)
    actions = [_action(file.section("actions"), key, default) for key in _action_names(file)]
    moved = [joint for action in actions for joint in action.joints]
    if len(set(moved)) < len(moved):
        raise UsageError(
            f"{path.name}: actions moves a joint twice; name each joint in one of {one_of(ACTIONS)}"
        )
    if len({bool(action.clip) for action in actions}) > 1:
        raise UsageError(f"{path.name}: actions must have a clip for each action or for none")
    sizes = _Sizes(joints=count, actions=len(moved), step=step)
    terms, by_time = _observation(file.section("observations"), sizes)
    found = Deployment(
        source=path.name,
        format="unitree",
        motors=() if motors == tuple(range(count)) else motors,
        joint_pos=default,
        stiffness=_of_motors(file, "stiffness", motors),
        damping=_of_motors(file, "damping", motors),
        step=step,
        terms=terms,
        history_by="time" if by_time else "term",
        action_scale=tuple(one for action in actions for one in action.scale),
        action_offset=tuple(one for action in actions for one in action.offset),
        action_clip=tuple(one for action in actions for one in action.clip),
        action_joints=() if moved == list(range(count)) else tuple(moved),
        velocity_joints=tuple(sorted(one for action in actions if action.velocity for one in action.joints)),
        command_ranges=_ranges(file.section("commands").section("base_velocity").section("ranges")),
        command_scale=next((term.scale for term in terms if term.name == "velocity_commands"), ()),
        files=(path,),
    )
    return replace(found, unused=file.unused())


def _of_motors(file: Section, key: str, motors: tuple[int, ...]) -> tuple[float, ...]:
    """Return gains in policy order; the file has them in motor order, with or without motors that are not moved."""
    gains = file.gains(key)
    if len(gains) > max(motors):
        return tuple(gains[motor] for motor in motors)
    if len(gains) == len(motors):
        return tuple(gains[rank] for rank in ranks(motors))
    needed = f"{len(motors)} or {max(motors) + 1}" if len(motors) <= max(motors) else f"{len(motors)}"
    file.fail(key, f"has {len(gains)} numbers instead of {needed}, one a motor by joint_ids_map")


def _ranges(section: Section) -> dict[str, tuple[float, float]]:
    return {key: section.interval(key) for key in RANGES if section.has(key)}


@dataclass(frozen=True)
class _Sizes:
    """Numbers of the policy's joints and actions, and the control period [s]."""

    joints: int
    actions: int
    step: float


def _observation(section: Section, sizes: _Sizes) -> tuple[tuple[Term, ...], bool]:
    """Return the terms of all groups, and whether histories are stacked by time."""
    if not section.values:
        raise UsageError(
            f"{section.source}: observations is empty; it must list the terms of the observation"
        )
    entries = {key: value for key, value in section.values.items() if isinstance(value, Mapping)}
    grouped = [key for key, value in entries.items() if value and not _TERM_KEYS & value.keys()]
    if grouped and len(grouped) < len(entries):
        section.fail(grouped[0], f"is a group, and others are terms: {one_of(entries.keys() - set(grouped))}")
    groups = {key: section.section(key) for key in grouped} or {"": section}
    terms: list[Term] = []
    by_time = False
    for name, group in groups.items():
        by_time |= _flag(group, "use_gym_history")
        clip_first = not _flag(group, "scale_first")
        keys = [key for key in group.values if key not in ("use_gym_history", "scale_first")]
        terms += [replace(_term(group, key, sizes), group=name, clip_first=clip_first) for key in keys]
    if by_time and len({term.history for term in terms}) > 1:
        raise UsageError(
            f"{section.source}: observations.use_gym_history needs one history_length for all terms"
        )
    return tuple(terms), by_time


def _flag(section: Section, key: str) -> bool:
    value = section.get(key)
    if value not in (None, True, False):
        section.fail(key, f"must be true or false, not {shown(value)}")
    return bool(value)


def _term(group: Section, key: str, sizes: _Sizes) -> Term:
    values = group.section(key)
    params = values.section("params")
    params.get("command_name")  # it names base_velocity, the only command of these files
    assets = params.section("asset_cfg")
    joints = assets.indices("joint_ids", sizes.joints) if isinstance(assets.get("joint_ids"), list) else ()
    name = OTHER_NAMES.get(key, key)
    history = values.whole("history_length", 0, MOST_HISTORY) if values.has("history_length") else 1
    term = Term(
        name,
        scale=_scale(values, _width(name, joints, sizes)),
        clip=values.interval("clip") if values.has("clip") else None,
        history=max(history, 1),
        joints=joints if name in JOINTS else (),
        source=group.place(key),
    )
    return _phase(term, params, sizes.step) if name == "phase" else term


def _width(name: str, joints: tuple[int, ...], sizes: _Sizes) -> int | None:
    """Return the number of components of a term; None where its name has no meaning here."""
    if name in JOINTS:
        return len(joints) or sizes.joints
    return {"last_action": sizes.actions, "phase": 2, **dict.fromkeys(VECTORS, 3)}.get(name)


def _scale(values: Section, width: int | None) -> tuple[float, ...]:
    """Return the scale, shortened: () where it is 1, one number where all are equal."""
    if not values.has("scale"):
        return ()
    if is_number(values.get("scale")):
        scale: tuple[float, ...] = (values.number("scale"),)
    else:
        scale = values.numbers("scale", width, "one a component of the term")
    if width is not None and len(set(scale)) == 1:
        scale = scale[:1]
    return () if scale == (1.0,) else scale


def _phase(term: Term, params: Section, step: float) -> Term:
    """Return the phase of the gait: sin and cos of 2π t/period.

    The controller advances it before each observation, and once more when it resets: the first one is at two steps.
    """
    period = params.number("period", positive=True)
    return replace(term, frequency=1 / period, start=(4 * pi * step / period,), parts=("sin", "cos"))


@dataclass(frozen=True)
class _Action:
    """An action: the joints that it moves, in policy order, and for each of them how."""

    joints: tuple[int, ...]
    scale: tuple[float, ...]
    offset: tuple[float, ...]
    clip: tuple[tuple[float, float], ...]
    velocity: bool


def _action_names(file: Section) -> tuple[str, ...]:
    names = tuple(file.section("actions").values)
    unknown = {*names} - {*ACTIONS}
    if unknown or not names:
        raise UsageError(
            f"{file.source}: actions has {one_of(unknown)}; the known actions are {one_of(ACTIONS)}"
        )
    return names


def _action(section: Section, key: str, joint_pos: tuple[float, ...]) -> _Action:
    action = section.section(key)
    action.get("joint_names")  # patterns; joint_ids has what they select
    moved = _moved(action, len(joint_pos))
    scale = action.spread("scale", len(moved), _MOVED) if action.has("scale") else (1.0,) * len(moved)
    velocity = key == "JointVelocityAction"
    if "offset" not in action.values:  # Isaac Lab's default: positions are relative to the default pose
        offset = tuple(0.0 if velocity else joint_pos[joint] for joint in moved)
    elif action.has("offset"):
        offset = action.spread("offset", len(moved), _MOVED)
    else:
        offset = (0.0,) * len(moved)
    return _Action(moved, scale, offset, _limits(action, len(moved)), velocity)


def _moved(action: Section, count: int) -> tuple[int, ...]:
    """Return the joints that an action moves, in policy order: all, a Python slice, or a list."""
    value = action.get("joint_ids")
    if isinstance(value, Tagged) and value.tag == _SLICE:
        limits = value.value if isinstance(value.value, list) else [0, 0, 0, 0]
        whole = all(one is None or isinstance(one, int) for one in limits)
        if whole and 1 <= len(limits) <= 3 and 0 not in limits[2:]:
            return tuple(range(count)[slice(*limits)])
        action.fail("joint_ids", f"has a slice with the limits {shown(value.value)}; use a list of indices")
    return tuple(range(count)) if value is None else action.indices("joint_ids", count)


def _limits(action: Section, count: int) -> tuple[tuple[float, float], ...]:
    """Return the limits of the targets: a pair for each joint."""
    value = action.get("clip")
    if value is None:
        return ()
    if not isinstance(value, list) or len(value) != count:
        action.fail("clip", f"must be a list of {count} pairs of limits, not {shown(value)}")
    pairs = Section(
        {str(index): pair for index, pair in enumerate(value)}, action.source, action.name("clip")
    )
    return tuple(pairs.interval(key) for key in pairs.values)
