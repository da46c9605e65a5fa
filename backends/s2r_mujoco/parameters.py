"""The parameters of a robot's tests: components of the command, fields of the model, and pushes."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.description import COMMANDS, Description, ParameterTable
from s2r_mujoco.model import ModelFile
from s2r_mujoco.plan import Plan
from s2r_spec.backend import Parameter
from s2r_spec.errors import UsageError, one_of, suggest

UNITS = {
    "mass": "kg", "frictionloss": "N*m", "armature": "kg*m^2", "damping": "N*m*s/rad", "stiffness": "N*m/rad",
    "gravity": "m/s^2", "pos": "m", "size": "m", "range": "rad", "ref": "rad", "springref": "rad",
    "actfrcrange": "N*m", "density": "kg/m^3", "wind": "m/s",
}  # fmt: skip
"""Definition: attribute of a field → its unit where `unit` is missing, for hinges; another attribute has none."""
LINEAR_UNITS = {
    "frictionloss": "N", "armature": "kg", "damping": "N*s/m", "stiffness": "N/m", "range": "m", "ref": "m",
    "springref": "m", "springlength": "m", "actfrcrange": "N",
}  # fmt: skip
"""Definition: attribute of a slide or a tendon → its unit where it differs from that of a hinge."""
ANGLES = ("range", "ref", "springref")
"""Definition: attributes of a hinge in degrees, unless the model's file has ``<compiler angle="radian"/>``."""


@dataclass(frozen=True)
class TestParameter:
    """A parameter of a test; ``limited`` tells whether a file states its range. Its default changes nothing."""

    declared: Parameter
    limited: bool


def parameters_of(
    description: Description, plan: Plan, file: ModelFile, model: Any
) -> dict[str, TestParameter]:
    """Return name → parameter.

    Raises:
        UsageError: a field, a body or a unit does not fit the model, or a name stands for two things.
    """
    source, tables = description.path.name, description.table.parameters
    found: dict[str, TestParameter] = {}
    for name, command in plan.commands.items():
        if command.parameter in tables:
            raise UsageError(
                f"{source}: {command.parameter} is both a command and a key of parameters; rename one of them"
            )
        if command.parameter:
            limits = command.range or plan.ranges.get(name)
            still = 0.0 if limits is None else min(max(0.0, limits[0]), limits[1])
            found[command.parameter] = _declared(
                command.parameter, COMMANDS[name], limits, still, f"command of {name}"
            )
    for name, table in tables.items():
        place = f"{source}: parameters.{name}"
        found[name] = (
            _push(name, table, model, place) if table.push else of_field(name, table, file, model, place)
        )
    return found


def _push(name: str, table: ParameterTable, model: Any, place: str) -> TestParameter:
    unit = "N" if table.unit is None else table.unit
    words = f"force on {table.push} from {table.at:g} s on, for {table.lasts:g} s"
    if not model.body_weldid[body_of(model, table.push, place)]:
        raise UsageError(f"{place}: the body {table.push!r} is fixed; push another")
    return _declared(name, unit, table.range, 0.0, words)


def of_field(name: str, table: ParameterTable, file: ModelFile, model: Any, place: str) -> TestParameter:
    """Return the parameter of a field; ``place`` is that of its table, for messages.

    Raises:
        UsageError: the model has no such field, or its unit or its value does not fit the table.
    """
    if table.field == "option/timestep":
        raise UsageError(
            f"{place}: a test cannot change the time step, since the control period would change with it; write "
            f"`timestep` and `decimation` into a robot file of its own"
        )
    value = file.value(table.change)
    own = "" if table.how == "scale" else _unit(table.field, file, model)
    unit = own if table.unit is None else table.unit
    if own and not _is_same_unit(own, unit):
        raise UsageError(
            f"{place}: the model has {table.field} in {own}, and not in {unit}; write the numbers in {own}"
        )
    default = {"set": value, "add": 0.0, "scale": 1.0}[table.how]
    if table.range and not table.range[0] <= default <= table.range[1]:
        raise UsageError(
            f"{place}: the range {list(table.range)} does not contain {default:g}, which leaves the model as it is; "
            f'change the range, or write how = "add" for a change of the value'
        )
    return _declared(name, unit, table.range, default, f"{table.how} {table.field}")


def _unit(field: str, file: ModelFile, model: Any) -> str:
    """Return the unit of a field; "" if it has none, or if hinges and slides fit its name."""
    kind, name, *rest = field.split("/")
    attribute = name if kind == "option" else rest[0]
    joints = [model.joint(joint) for joint in range(model.njnt)]
    linear = {
        int(one.type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
        for one in joints
        if kind == "joint" and fnmatchcase(one.name, name)
    } or {kind == "tendon"}
    if len(linear) > 1 and attribute in LINEAR_UNITS:
        return ""
    if attribute in ANGLES and True not in linear and file.spec().compiler.degree:
        return "deg"
    return (UNITS | LINEAR_UNITS if True in linear else UNITS).get(attribute, "")


def body_of(model: Any, name: str, source: str) -> int:
    """Return the number of a body; ``source`` is the place of its name, for messages."""
    names = [model.body(body).name for body in range(model.nbody)]
    if name not in names:
        raise UsageError(
            f"{source}: the model has no body {name!r}{suggest(name, names)} it has {one_of(names)}"
        )
    return names.index(name)


def _is_same_unit(one: str, other: str) -> bool:
    try:
        return Parameter("", one, -np.inf, np.inf, 0.0, "").check(f"1 {other}") == 1.0
    except UsageError:
        return False


def _declared(name: str, unit: str, limits: Any, default: float, words: str) -> TestParameter:
    low, high = limits or (default, default)
    return TestParameter(Parameter(name, unit, low, high, default, words), limits is not None)
