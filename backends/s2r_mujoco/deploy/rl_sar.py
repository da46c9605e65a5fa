"""Read base.yaml and config.yaml of rl_sar.

``base.yaml`` describes the robot, ``config.yaml`` one policy; a key of the policy replaces the robot's. All lists are
in policy order, but for the joint names of ``base.yaml``: policy joint i is motor ``joint_mapping[i]``, which has the
name ``joint_names[joint_mapping[i]]``. An observation is scaled, then limited to ±``clip_obs``; histories begin with
zeros. An action is limited before it is scaled. Older files are read, too: ``state_mapping``, one ``action_scale`` for
all joints with ``hip_scale_reduction``, ``use_history``, joint names in ``config.yaml``. Source:
src/rl_sar/library/core of rl_sar, at the newest version and at those of 2024 and 2025.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import Any

from s2r_mujoco.deploy.record import MOST_HISTORY, MOST_JOINTS, Deployment, Term
from s2r_mujoco.deploy.section import Section, is_number
from s2r_mujoco.deploy.yaml import read
from s2r_spec.errors import UsageError, one_of, shortened

BASE = "base.yaml"
"""Definition: the robot's file."""
VECTORS = {
    "lin_vel": ("base_lin_vel", "lin_vel_scale"),
    "ang_vel": ("base_ang_vel", "ang_vel_scale"),
    "ang_vel_body": ("base_ang_vel", "ang_vel_scale"),
    "ang_vel_world": ("base_ang_vel", "ang_vel_scale"),
    "gravity_vec": ("projected_gravity", ""),
    "commands": ("velocity_commands", "commands_scale"),
    "dof_pos": ("joint_pos_rel", "dof_pos_scale"),
    "dof_vel": ("joint_vel", "dof_vel_scale"),
    "actions": ("last_action", ""),
}
"""Definition: rl_sar's name of a term → its name here, and the key of its scale. ``ang_vel_world`` is measured in the
world and turned into the body, so all three angular velocities are the body's."""
PHASES = {"g1_phase": (1.25,), "phase": (0.25, 0.125, 0.0625)}
"""Definition: rl_sar's name of a phase → its frequencies [Hz]; each has a sine and a cosine."""
OLD_HISTORY = 6
"""Definition: observations that ``use_history: true`` keeps."""


@dataclass(frozen=True)
class _Files:
    """The sections of a policy and of its robot."""

    policy: Section
    robot: Section | None

    def of(self, key: str) -> Section:
        """Return the section that gives a key: the policy's, else the robot's where that has it."""
        if self.robot is None or key in self.policy.values or key not in self.robot.values:
            return self.policy
        return self.robot

    def has(self, key: str) -> bool:
        return self.of(key).has(key)

    def number(self, key: str, positive: bool = False) -> float:
        return self.of(key).number(key, positive)

    def joints(self, key: str, count: int) -> tuple[float, ...]:
        return self.of(key).numbers(key, count, "one a joint by num_of_dofs")

    def gains(self, key: str, count: int) -> tuple[float, ...]:
        return self.of(key).gains(key, count, "one a joint by num_of_dofs")

    def indices(self, key: str, count: int) -> tuple[int, ...]:
        return self.of(key).indices(key, count) if self.has(key) else ()


def policies(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the keys of a file whose value is a policy of rl_sar, or a robot of it."""
    return tuple(
        key
        for key, value in values.items()
        if isinstance(value, Mapping) and {"num_of_dofs", "default_dof_pos"} <= value.keys()
    )


def deployment(values: Mapping[str, Any], path: Path, key: str = "") -> Deployment:
    """Return what the files of a policy say; ``key`` chooses one of several policies.

    Raises:
        UsageError: the file has several policies and no key chooses one, a key is missing, or a list has another
            length than ``num_of_dofs``.
    """
    found = policies(values)
    if key and key not in found:
        raise UsageError(f"{path} has no policy {key!r}; it has {one_of(found)}")
    if not key and len(found) > 1:
        raise UsageError(f"{path} has the policies {one_of(found)}; choose one: {path.name}#{found[0]}")
    key = key or found[0]
    policy = Section(values[key], path.name, key)
    if "observations" not in policy.values:
        hint = "give the config.yaml of the policy instead" if path.name == BASE else "add it"
        raise UsageError(f"{path.name}: {key} has no 'observations' (a list of names); {hint}")
    base = _base(path, key)
    robot = _robot(base, key) if base else None
    files = _Files(policy, robot)
    result = _read(files, path)
    unused = policy.unused() + tuple(
        name for name in (robot.unused() if robot else ()) if name.rpartition(".")[2] not in policy.values
    )
    return replace(
        result,
        source=f"{path.name} and {BASE}" if base else path.name,
        files=(path, base) if base else (path,),
        unused=unused,
    )


def _base(path: Path, key: str) -> Path | None:
    """Return the robot's file: beside the policy's, or above it, by as many folders as the key has slashes."""
    folder = path.absolute().parent
    folders = (folder, *folder.parents)[: 1 + max(1, key.count("/"))]
    return next(
        (one / BASE for one in folders if one / BASE != path.absolute() and (one / BASE).is_file()), None
    )


def _robot(base: Path, key: str) -> Section:
    values = read(base)
    robots = policies(values) if isinstance(values, Mapping) else ()
    name = key.partition("/")[0]
    if name not in robots:
        raise UsageError(
            f"{base} has no robot {name!r} for the policy {shortened(key)!r}; it has {one_of(robots)}"
        )
    return Section(values[name], base.name, name)


def _read(files: _Files, path: Path) -> Deployment:
    count = files.of("num_of_dofs").whole("num_of_dofs", 1, MOST_JOINTS)
    if files.has("rows") and files.has("framework") and files.policy.text("framework") == "isaacsim":
        files.policy.fail(
            "rows", "reorders all lists, as rl_sar did in 2024; write the lists in policy order"
        )
    period = files.number("dt", True) * files.number("decimation", True) if files.has("dt") else None
    clip = files.number("clip_obs", positive=True)
    wheels = files.indices("wheel_indices", count)
    history, newest_first, by = _history(files.policy)
    terms = [
        replace(term, history=history, newest_first=newest_first)
        for name in _names(files.policy)
        for term in _terms(files, name, count, period)
    ]
    motors = _motors(files, count)
    default = files.joints("default_dof_pos", count)
    return Deployment(
        source=path.name,
        format="rl_sar",
        joints=_joints(files, motors or tuple(range(count)), count),
        motors=motors if motors != tuple(range(count)) else (),
        joint_pos=default,
        stiffness=files.gains("rl_kp", count),
        damping=files.gains("rl_kd", count),
        torque_limit=files.gains("torque_limits", count) if files.has("torque_limits") else (),
        step=period,
        terms=tuple(terms),
        history_by=by,
        history_start="zero",
        observation_clip=(-clip, clip),
        action_scale=_action_scale(files, wheels, count),
        action_offset=default,
        action_clip=_action_clip(files, count),
        action_clip_first=True,
        velocity_joints=tuple(sorted(wheels)),
        command_scale=next((term.scale for term in terms if term.name == "velocity_commands"), ()),
        policy=files.policy.text("model_name"),
    )


def _names(policy: Section) -> tuple[str, ...]:
    names = policy.texts("observations")
    if not names:
        policy.fail("observations", "is empty; it must list the terms of the observation")
    return names


def _terms(files: _Files, name: str, count: int, period: float | None) -> list[Term]:
    """Return the terms of one name of rl_sar: one, or one for each frequency of a phase."""
    source = f"{files.policy.place('observations')}: {name}"
    if name in PHASES:
        if period is None:
            files.policy.fail("observations", f"has {name!r}, which needs dt and decimation of {BASE}")
        # The episode's counter is 1 at the first observation.
        return [
            Term(
                "phase",
                frequency=frequency,
                start=(2 * pi * frequency * period,),
                parts=("sin", "cos"),
                source=source,
            )
            for frequency in PHASES[name]
        ]
    if name not in VECTORS:
        return [Term(name, source=source)]
    own, key = VECTORS[name]
    scale: tuple[float, ...] = ()
    if key == "commands_scale":
        scale = files.of(key).numbers(key, 3, "one for each of x, y and yaw")
    elif key:
        scale = (files.number(key),)
    wheels = files.indices("wheel_indices", count) if name == "dof_pos" else ()
    if wheels:  # the angle of a wheel is no part of the observation: rl_sar sets it to 0
        scale = tuple(0.0 if joint in wheels else scale[0] for joint in range(count))
    if name == "actions" and files.has("hip_scale_reduction"):
        scale = _reduction(files, count)
    return [Term(own, scale=() if set(scale) == {1.0} else scale, source=source)]


def _history(policy: Section) -> tuple[int, bool, str]:
    """Return the number of observations, whether the newest is the first, and what they are stacked by."""
    if policy.get("use_history") is True:
        return OLD_HISTORY, False, "time"
    by = policy.text("observations_history_priority") or "time"
    if by not in ("time", "term"):
        policy.fail("observations_history_priority", f"must be 'time' or 'term', not {shortened(by)!r}")
    ages = policy.indices("observations_history") if policy.has("observations_history") else ()
    if not ages:
        return 1, False, by
    upwards = tuple(range(len(ages)))
    if ages not in (upwards, upwards[::-1]) or len(ages) > MOST_HISTORY:
        policy.fail(
            "observations_history", f"must count from 0 up, or down to 0, not {shortened(str([*ages]))}"
        )
    return len(ages), ages == upwards and len(ages) > 1, by


def _motors(files: _Files, count: int) -> tuple[int, ...]:
    """Return the motor of each policy joint; () where the files do not say."""
    key = next((key for key in ("joint_mapping", "state_mapping") if files.has(key)), None)
    if key is None:
        return ()
    section = files.of(key)
    motors = section.indices(key)
    if len(motors) != count:
        section.fail(key, f"has {len(motors)} indices instead of {count}, one a joint by num_of_dofs")
    return motors


def _joints(files: _Files, motors: tuple[int, ...], count: int) -> tuple[str, ...]:
    """Return the names of the joints; those of the robot's file are in motor order."""
    if not files.has("joint_names"):
        return ()
    section = files.of("joint_names")
    names = section.texts("joint_names")
    if section is files.policy:
        if len(names) != count:
            section.fail(
                "joint_names", f"has {len(names)} names instead of {count}, one a joint by num_of_dofs"
            )
        return names
    if len(names) <= max(motors):
        section.fail("joint_names", f"has {len(names)} names, but joint_mapping has motor {max(motors)}")
    return tuple(names[motor] for motor in motors)


def _action_scale(files: _Files, wheels: tuple[int, ...], count: int) -> tuple[float, ...]:
    section = files.of("action_scale")
    scale = section.spread("action_scale", count, "one a joint by num_of_dofs")
    if not is_number(section.get("action_scale")):
        return scale
    if wheels and files.has("action_scale_wheel"):
        wheel = files.number("action_scale_wheel")
        scale = tuple(wheel if joint in wheels else one for joint, one in enumerate(scale))
    if files.has("hip_scale_reduction"):
        scale = tuple(one * part for one, part in zip(scale, _reduction(files, count), strict=True))
    return scale


def _reduction(files: _Files, count: int) -> tuple[float, ...]:
    """Return the factor of each action: the hips' in old files, which last_action has, too."""
    hips = files.indices("hip_scale_reduction_indices", count)
    factor = files.number("hip_scale_reduction")
    return tuple(factor if joint in hips else 1.0 for joint in range(count))


def _action_clip(files: _Files, count: int) -> tuple[tuple[float, float], ...]:
    keys = ("clip_actions_lower", "clip_actions_upper")
    if not all(files.of(key).get(key) for key in keys):  # null and [] are no limits
        return ()
    lower, upper = (files.joints(key, count) for key in keys)
    wrong = [joint for joint in range(count) if lower[joint] > upper[joint]]
    if wrong:
        files.of(keys[0]).fail(keys[0], f"is above {keys[1]} at joint {wrong[0]}")
    return tuple(zip(lower, upper, strict=True))
