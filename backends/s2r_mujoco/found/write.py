"""Two kinds of files from found effects: the machine with its fault, for a simulator, and its cure, for the robot.

``as_found.toml``, with ``as_found.xml``, is the user's robot file and model with the effects. An effect goes into the
XML if the simulator of the new files then equals the one that has it in memory, at the default test and at another one;
else it is in the table ``effects`` of the robot file. So delays and errors of sensors are there, and whatever a test
parameter would overwrite, or a model states in no single place.

``fix.yaml`` is the user's deploy file with the fault undone. With the measured factor s of a motor's strength, f of a
gain and the offset o of an encoder:

    kp' = kp / (f_p s),   kd' = kd / (f_d s),   default pose' = default pose + o,   offset of the action' = offset + o

Mistakes of the loop are keys of ``as_found.toml``, and scales of ``fix.yaml``; see :mod:`s2r_mujoco.found.loop`.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from s2r_mujoco import drive
from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.deploy import split
from s2r_mujoco.effects.physics import Physics
from s2r_mujoco.found import deploy_text, robot_text
from s2r_mujoco.found.loop import changed_keys, undone
from s2r_mujoco.found.model_text import changed_markup, place
from s2r_mujoco.interface.text import loop_text
from s2r_mujoco.law import Law
from s2r_mujoco.model import differences
from s2r_mujoco.robot import Robot
from s2r_spec.backend import Finding, LoopMistake
from s2r_spec.effects import Choice, as_values
from s2r_spec.errors import UsageError

TOML, XML = "as_found.toml", "as_found.xml"
WARNING = "The machine as it was found, with its fault: for a simulator, not for the robot."
CURE = "The deploy file with the fault undone: for the robot, not for a simulator."
OTHER = 1.25
"""Definition: another value of a test parameter without a range, in parts of its default."""
CURABLE = ("kp", "kd", "motor_strength", "encoder_offset")
"""Definition: effects that other numbers of a deploy file undo."""


def write(robot: Robot, choice: Choice, mistakes: Sequence[LoopMistake], folder: Path) -> list[Finding]:
    """Write the files of found effects and mistakes into a new folder, and return what each is.

    Args:
        robot: of the user's files.
        choice: the effects.
        mistakes: of the loop; the keys of each have those before it.
        folder: new.

    Raises:
        UsageError: the folder is there already, or cannot be written.
    """
    with _made_whole(folder) as work:
        draft = _Draft(robot, choice, tuple(mistakes), folder, work)
        in_model = [one for one in choice if draft.equals((one,), (one,))]
        if not draft.equals(choice, tuple(in_model)):
            in_model = []
            if not draft.equals(choice, ()):
                raise UsageError(f"{robot.name}: no robot file in another folder equals it; use --apply")
        return [draft.words(tuple(in_model)), _cure(robot, choice, mistakes, work)]


@contextmanager
def _made_whole(folder: Path) -> Iterator[Path]:
    """Give a folder beside to write to, which gets the name at the end, or vanishes after an error."""
    try:
        if folder.exists():
            folder.rmdir()  # succeeds for an empty folder alone
        folder.mkdir()  # with the permissions of the user's folders
        work = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.absolute().parent))
    except OSError as error:
        raise UsageError(f"cannot make the new folder {folder}: {error.strerror or error}") from None
    try:
        yield work
        for path in work.iterdir():
            os.rename(path, folder / path.name)
    except BaseException:
        folder.rmdir()
        raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


@dataclass(frozen=True)
class _Draft:
    """The files of a robot with effects and mistakes, written to ``work`` as they will be read in ``folder``."""

    robot: Robot
    choice: Choice
    mistakes: tuple[LoopMistake, ...]
    folder: Path
    work: Path

    @cached_property
    def found(self) -> Robot:
        """The robot with the loop of the mistakes."""
        keys = self.mistakes[-1].keys if self.mistakes else ""
        return Robot(self.robot.description.path, keys) if keys else self.robot

    def equals(self, choice: Choice, in_model: Choice) -> bool:
        """Write the files with some effects, of which some are in the model, and return whether they equal them."""
        try:
            self._write(choice, in_model)
            other = Robot(self.work / TOML)
        except (ValueError, UsageError):
            return False
        rest, found = other.stated, self.found
        if self.mistakes and loop_text(found.plan) != loop_text(other.plan):
            return False
        return _same_loop(found.physics(choice), other.physics(rest)) and all(
            _same(*_simulated(found, choice, one), *_simulated(other, rest, two))
            for one, two in _tests(found, other)
        )

    def _write(self, choice: Choice, in_model: Choice) -> None:
        for path in self.work.iterdir():
            path.unlink()
        robot, description = self.robot, self.robot.description
        changes = robot_text.moved_paths(description.table.model_dump(), description.path.parent, self.folder)
        changes |= changed_keys(robot, self.mistakes)
        if in_model:
            before = robot.file.compile()
            physics = robot.physics(in_model)
            after = robot.file.compile(edit=physics.edit)
            physics.change(after, physics.plan(robot.plan))
            markup = changed_markup(robot.file, before, after, self.work)
            markup.insert(markup.root, f"<!-- {WARNING} -->")
            place(markup, self.folder, self.work)
            changes["model"] = XML
        if robot.plan.law.pd != "model":  # s2r may have chosen it, by the masses of the model
            changes["action.pd"] = robot.plan.law.pd
        units = {one.name: {p.name: p.unit for p in one.parameters} for one in robot.catalogue}
        rest = as_values(tuple(one for one in choice if one not in in_model))
        text = description.path.read_text(encoding="utf-8")
        text = robot_text.changed_text(text, changes, rest, units, WARNING)
        (self.work / TOML).write_text(text, encoding="utf-8")

    def words(self, in_model: Choice) -> Finding:
        """Return what the files are, and where each effect is."""
        rest = [name for name, _ in self.choice if name not in dict(in_model)]
        parts = [f"{TOML} is {self.robot.name} with what was found: use it as --sim {self.folder / TOML}"]
        if in_model:
            parts.append(f"{XML} has {_listed(dict(in_model))}")
        if self.mistakes:
            parts.append(f"its loop has {_quoted(self.mistakes)}")
        if rest:
            parts.append(f"its table [effects] has {_listed(rest)}, which the model cannot state")
        return Finding("as found", "; ".join(parts))


def _simulated(robot: Robot, choice: Choice, values: Mapping[str, float]) -> tuple[Any, Law]:
    """Return the compiled model and the law of a test with effects."""
    physics = robot.physics(choice)
    model = robot.file.compile(robot.changes(values), edit=physics.edit)
    plan = physics.plan(robot.plan)
    drive.prepare_actuators(model, plan)
    physics.change(model, plan)
    return model, plan.law


def _tests(one: Robot, other: Robot) -> Iterator[tuple[dict[str, float], dict[str, float]]]:
    """Yield the default test of each robot, and one test with other values for both."""
    yield tuple({name: p.declared.default for name, p in robot.parameters.items()} for robot in (one, other))  # type: ignore[misc]
    values = {}
    for name, parameter in one.parameters.items():
        p = parameter.declared
        ends = [end for end in (p.high, p.low) if parameter.limited and end != p.default]
        values[name] = ends[0] if ends else OTHER * p.default
    yield values, values


def _same(one: Any, law: Law, other: Any, other_law: Law) -> bool:
    """Return whether two simulators have the same model and the same law from actions to torques."""
    names = {*vars(law)} - ({"unit"} if law.pd == "model" else set())  # a unit is of torques from gains
    return not differences(one, other) and all(
        np.array_equal(getattr(law, name), getattr(other_law, name)) for name in names
    )


def _same_loop(one: Physics, other: Physics) -> bool:
    """Return whether delays, the lag and errors of sensors are the same."""
    return all(np.allclose(getattr(one, name), getattr(other, name), 1e-9, 0.0) for name in _LOOP)


_LOOP = (
    "offset", "tilt", "gyro", "sensing", "sensing_jitter", "sending", "sending_jitter", "lag", "slope", "sag",
)  # fmt: skip
"""Definition: fields of :class:`.Physics` that act between the model and the controller. An IMU finds the vertical by
gravity, so a slope is in its attitude, too."""


def _cure(robot: Robot, choice: Choice, mistakes: Sequence[LoopMistake], work: Path) -> Finding:
    """Write the deploy file with the fault undone, and return what it is, or why there is none."""
    stated, names, loop = (
        robot.description.table.deploy,
        [name for name, _ in choice],
        undone(robot, mistakes),
    )
    never = [name for name in names if name not in CURABLE]
    words = f"; no number of a deploy file undoes {_listed(never)}" if never else ""
    if not stated:
        words = f"; correct in the code: {_quoted(mistakes)}" if mistakes else ""
        return Finding("fix", f"there is no fix, since {robot.name} names no deploy file{words}")
    words += f"; correct in the code: {_quoted(loop.never)}" if loop.never else ""
    able = [*(name for name in names if name in CURABLE), *map(_quoted, ([one] for one in loop.able))]
    path = robot.description.beside(stated)
    name = f"fix{split(path)[0].suffix}"
    if not able:
        return Finding("fix", f"{name} is not written{words}")
    wanted = _undone(robot, choice) | ({} if loop.action is None else {"action_scale": loop.action})
    try:
        text = deploy_text.changed_text(path, wanted, loop.terms)
    except deploy_text.UnplacedError as error:
        scales = {f"scale of {robot.plan.terms[k].name}": own for k, own in loop.terms.items()}
        rows = tuple(
            f"{key}: {' '.join(f'{one:.6g}' for one in row)}" for key, row in (wanted | scales).items()
        )
        words = f"{name} is not written, since {Path(stated).name} cannot say it: {error}{words}"
        return Finding("fix", f"{words}. It would have, in the order of the policy:", "note", rows)
    (work / name).write_text(f"# {CURE}\n{text}", encoding="utf-8")
    return Finding("fix", f"{name} is {Path(stated).name} with {_listed(able)} undone: for the robot{words}")


def _undone(robot: Robot, choice: Choice) -> dict[str, FloatArray]:
    """Return the lists of the deploy file, in the order of the policy, with which the robot has no fault."""
    deployment, law, joints = robot.deployment, robot.plan.law, robot.plan.joints
    physics, found = robot.physics(choice), dict[str, FloatArray]()
    strength = physics.strength[joints.actuators]
    for name, factor in (("stiffness", physics.stiffness), ("damping", physics.derivative)):
        if getattr(deployment, name) and ((all_ := factor[joints.actuators] * strength) != 1.0).any():
            found[name] = np.array(getattr(deployment, name)) / all_
    shift = physics.offset[joints.dof]
    if shift.any():
        found["joint_pos"] = np.array(deployment.joint_pos) + shift
        moves = np.where(law.speed, 0.0, shift)[law.moved]
        found["action_offset"] = np.array(deployment.action_offset) + moves
    return found


def _listed(names: Any) -> str:
    return ", ".join(names)


def _quoted(mistakes: Sequence[LoopMistake]) -> str:
    return _listed(f'"{one.name}"' for one in mistakes)
