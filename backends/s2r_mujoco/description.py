"""The robot file (``robot.toml``): what a user writes about a model and its controller, checked key by key.

The vocabulary is that of Isaac Lab. A key that is missing here may stand in the deploy file or in the model;
``plan.py`` puts the three together.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from s2r_mujoco.deploy.record import MOST_HISTORY, Deployment, Term
from s2r_mujoco.model import FieldChange
from s2r_mujoco.toml import Table, checked, read_toml
from s2r_spec.backend import Parameter
from s2r_spec.errors import UsageError, one_of, shortened, suggest

COMMANDS = {"lin_vel_x": "m/s", "lin_vel_y": "m/s", "ang_vel_z": "rad/s"}
"""Definition: components of a velocity command, in the order of the term ``velocity_commands``, and their units."""


def _several(value: Any) -> Any:
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _both(value: Any) -> Any:
    """Return the limits −c and c for one number c."""
    return (-value, value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError(f"the first limit {limits[0]:g} is above the second, {limits[1]:g}")
    return limits


def _seconds(value: Any) -> Any:
    try:
        free = Parameter("the time", "s", 0.0, math.inf, 0.0, "")
        return free.check(value) if isinstance(value, str) else value
    except UsageError as error:
        raise ValueError(str(error)) from None


Numbers = Annotated[tuple[float, ...], BeforeValidator(_several)]
PerJoint = Annotated[tuple[float, ...] | dict[str, float], BeforeValidator(_several)]
"""One number, one a joint in policy order, or a table from names of joints, as regular expressions, to numbers."""
Limits = Annotated[tuple[float, float], BeforeValidator(_both), AfterValidator(_ordered)]
Seconds = Annotated[float, BeforeValidator(_seconds), Field(ge=0.0)]
Range = Annotated[tuple[float, float], AfterValidator(_ordered)]


_TABLES = {"sensor": '{ sensor = "NAME" }', "phase": '{ phase = 1.5, unit = "Hz" }'}
"""Definition: term that needs a table → an example."""


class TermTable(Table):
    """A term of the observation with further keys; it has one of ``term``, ``sensor`` and ``phase``."""

    term: str = ""
    sensor: str = ""
    phase: float | None = Field(default=None, gt=0)
    unit: Literal["Hz", "s"] = "Hz"
    start: Numbers = (0.0,)
    parts: tuple[Literal["sin", "cos"], ...] = Field(default=("sin", "cos"), alias="as")
    scale: Numbers = ()
    clip: Limits | None = None
    history: int = Field(default=1, ge=1, le=MOST_HISTORY)
    newest_first: bool = False
    frame: str = "body"
    joints: tuple[str, ...] = ()
    order: tuple[Annotated[int, Field(ge=0)], ...] = ()
    late: int = Field(default=0, ge=0, le=MOST_HISTORY)

    @model_validator(mode="after")
    def _one(self) -> Self:
        if bool(self.term) + bool(self.sensor) + (self.phase is not None) != 1:
            raise ValueError("give exactly one of term, sensor and phase")
        if self.term in _TABLES:
            raise ValueError(f"write {_TABLES[self.term]} for a {self.term}")
        kind = "phase" if self.phase is not None else self.term or "sensor"
        own = {"unit": "phase", "start": "phase", "parts": "phase", "joints": "joint_", "frame": "base_"}
        for key in self.model_fields_set & own.keys():
            others = {("frame", "projected_gravity"), ("frame", "sensor")}
            if not kind.startswith(own[key]) and (key, kind) not in others:
                raise ValueError(f"a term {kind!r} has no {'as' if key == 'parts' else key}; leave it out")
        return self

    def read(self, source: str) -> Term:
        """Return the term; ``source`` is its place, for messages."""
        name = self.term or ("sensor" if self.sensor else "phase")
        shared = {
            name: getattr(self, name)
            for name in ("scale", "clip", "history", "newest_first", "frame", "order", "late")
        } | {"names": self.joints}
        if self.phase is None:
            return Term(name, sensor=self.sensor, source=source, **shared)
        frequency = self.phase if self.unit == "Hz" else 1.0 / self.phase
        return Term(name, frequency=frequency, start=self.start, parts=self.parts, source=source, **shared)


class ActionTable(Table):
    """How an action becomes a target of the joints, and a target a torque."""

    scale: PerJoint = ()
    offset: PerJoint = ()
    clip: Limits | None = None
    joints: tuple[str, ...] = ()
    order: tuple[Annotated[int, Field(ge=0)], ...] = ()
    pd: Literal["explicit", "implicit"] | None = None
    stiffness: PerJoint = ()
    damping: PerJoint = ()
    hold: dict[str, tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]]] = Field(
        default_factory=dict
    )

    @field_validator("stiffness", "damping")
    @classmethod
    def _gains(cls, values: PerJoint) -> PerJoint:
        if any(one < 0 for one in (values.values() if isinstance(values, dict) else values)):
            raise ValueError("a gain is at least 0; one below 0 drives a joint away from its target")
        return values


class CommandTable(Table):
    """A component of the command: a number, or a parameter of the specification with its range."""

    parameter: str = ""
    value: float = 0.0
    range: Range | None = None


class ParameterTable(Table):
    """A test parameter: a field of the model, or a push."""

    field: str = ""
    how: Literal["set", "add", "scale"] = "set"
    unit: str | None = None
    range: Range | None = None
    push: str = ""
    at: Seconds = 0.0
    lasts: Seconds = Field(default=0.1, alias="for")
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)

    @field_validator("unit")
    @classmethod
    def _unit(cls, unit: str | None) -> str | None:
        try:
            Parameter("", unit or "", 0.0, 0.0, 0.0, "").check(f"0 {unit or ''}")
        except UsageError:
            raise ValueError(
                f'{shortened(repr(unit))} is not a unit; write one such as "kg" or "N*m"'
            ) from None
        return unit

    @model_validator(mode="after")
    def _one(self) -> Self:
        if bool(self.field) + bool(self.push) != 1:
            raise ValueError('give either field = "KIND/NAME/ATTRIBUTE" or push = "BODY"')
        if not any(self.direction):
            raise ValueError("direction has the length 0; give one such as [1, 0, 0]")
        return self

    @property
    def change(self) -> FieldChange:
        """The change of the model's field."""
        return FieldChange(self.field, self.how)


class NoiseTable(Table):
    """Standard deviations of the start: joints in rad or m and per s, base in m, rad, m/s and rad/s."""

    joint_pos: float = Field(default=0.0, ge=0)
    joint_vel: float = Field(default=0.0, ge=0)
    base_lin_vel: float = Field(default=0.0, ge=0)
    base_ang_vel: float = Field(default=0.0, ge=0)


class StartTable(Table):
    """The state at t = 0."""

    joint_pos: Literal["default", "keyframe", "model"] | dict[str, float] | None = None
    height: float | None = None
    noise: NoiseTable = NoiseTable()


class RobotFile(Table):
    """The content of a robot file."""

    model: str = ""
    policy: str = ""
    deploy: str = ""
    keyframe: str = ""
    floor: bool = False
    motors: bool = False
    root: str = ""
    timestep: float | None = Field(default=None, ge=1e-6, le=1.0)
    decimation: int | None = Field(default=None, ge=1, le=100_000)
    duration: float = Field(default=5.0, gt=0, le=86_400.0)
    catalogue: str = ""
    observation: tuple[str | TermTable, ...] = ()
    observation_clip: Limits | None = None
    default_joint_pos: PerJoint = ()
    history_by: Literal["term", "time"] | None = None
    action: ActionTable = ActionTable()
    command: dict[str, float | str | CommandTable] = Field(default_factory=dict)
    parameters: dict[str, ParameterTable] = Field(default_factory=dict)
    fields: dict[str, float] = Field(default_factory=dict)
    start: StartTable = StartTable()
    failure: dict[str, str] = Field(default_factory=dict)
    effects: dict[str, dict[str, float]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _names(self) -> Self:
        """Refuse names that a specification cannot use, two parameters of one name, and keys without effect."""
        unused = self.action.model_fields_set - {"joints"}
        if ".py:" in self.policy and (unused or self.observation):
            key = f"action.{min(unused)}" if unused else "observation"
            raise ValueError(f"{key} has no effect, since {self.policy} returns the controls; leave it out")
        commands = [one.parameter for one in self.command.values() if isinstance(one, CommandTable)]
        commands += [one for one in self.command.values() if isinstance(one, str)]
        names = [name for name in (*commands, *self.parameters) if name]
        for name in (*names, *self.failure):
            if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
                raise ValueError(f"{name!r} is not a name of letters, digits and _")
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two parameters have the name {name!r}; rename one")
        return self


_OF_TESTS = ("policy", "observation", "command", "parameters", "failure", "root")
"""Definition: keys of a robot file that only a policy, a test with it, or a free base needs."""


@dataclass(frozen=True)
class Description:
    """A robot file that was read: its path, and its content."""

    path: Path
    table: RobotFile

    def beside(self, name: str) -> Path:
        """Return a path that the file names, relative to its own folder."""
        return self.path.parent / name

    def completed(self, deployment: Deployment) -> Description:
        """Return the description with the policy and the model of a deploy file, where the robot file names none.

        Raises:
            UsageError: the deploy file names a file that does not exist.
        """
        stated = {"policy": deployment.policy, "model": deployment.model}
        found = {key: name for key, name in stated.items() if name and not getattr(self.table, key)}
        paths = {key: self._stated(key, name, deployment.files[0]) for key, name in found.items()}
        return replace(self, table=self.table.model_copy(update=paths))

    def held(self) -> Description:
        """Return the description of the robot in the air, without its policy and what only its tests have."""
        empty = {
            name: RobotFile.model_fields[name].get_default(call_default_factory=True) for name in _OF_TESTS
        }
        return replace(self, table=self.table.model_copy(update=empty))

    def _stated(self, key: str, name: str, deploy: Path) -> str:
        """Return a path of a deploy file: relative to its folder, or after a variable to a folder above."""
        rest = re.sub(r"^[{$][^/]*/", "", name)
        above = deploy.resolve().parents
        path = next((one / rest for one in above if (one / rest).is_file()), None)
        if path is None or (rest == name and path.parent != (above[0] / rest).parent):
            raise UsageError(
                f"{self.path.name} names no {key}, and {deploy.name} names {name!r}, which does not exist; "
                f"write `{key}`"
            )
        return str(path)

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the observation; empty if the file names none."""
        found = []
        for number, one in enumerate(self.table.observation):
            source = f"{self.path.name}: observation[{number}]"
            if one in _TABLES:
                raise UsageError(f"{source}: write {_TABLES[one]} for a {one}")
            found.append(Term(one, source=source) if isinstance(one, str) else one.read(source))
        return tuple(found)

    @property
    def commands(self) -> dict[str, CommandTable]:
        """Component of the command → its table."""
        unknown = [name for name in self.table.command if name not in COMMANDS]
        if unknown:
            raise UsageError(
                f"{self.path.name}: command.{unknown[0]} is not a component of the velocity command"
                f"{suggest(unknown[0], COMMANDS)} they are {one_of(COMMANDS)}"
            )
        return {name: _command(one) for name, one in self.table.command.items()}


def _command(value: float | str | CommandTable) -> CommandTable:
    if isinstance(value, CommandTable):
        return value
    return CommandTable(parameter=value) if isinstance(value, str) else CommandTable(value=value)


def read_description(path: Path, loop: str = "") -> Description:
    """Read a robot file; ``loop`` has keys in TOML that replace its own.

    Raises:
        UsageError: the file is missing, is not TOML, or has a wrong key or value; the message names it.
    """
    table = read_toml(path, "robot file")
    if loop:
        other = tomllib.loads(loop)
        table |= other | {"action": table.get("action", {}) | other.get("action", {})}
    return Description(path, checked(RobotFile, table, path))
