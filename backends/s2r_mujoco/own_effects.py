"""The user's own catalogue (``effects.toml``): changes of the automatic one, and effects that it lacks.

A key is the name of an effect, and below it that of a parameter. ``false`` leaves out either; a table changes a
parameter, or adds one by a field of the model, in the words of ``parameters`` of a robot file. ``kinds`` has joints of
one size by regular expressions. ``parameters`` names a ``ParameterDict`` of ``mujoco.sysid``: each of its parameters
that is not frozen is an effect, from its nominal value within its bounds, and its ``modifier`` applies it.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, Field

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.description import ParameterTable, Range
from s2r_mujoco.effects.catalogue import RARE
from s2r_mujoco.effects.kinds import kind_name
from s2r_mujoco.effects.physics import Edit
from s2r_mujoco.joints import by_patterns, name_of, scalar_joints
from s2r_mujoco.model import FieldChange, ModelFile, differences
from s2r_mujoco.parameters import of_field
from s2r_mujoco.toml import Table, checked, read_toml
from s2r_spec.backend import EffectParameter, load_code
from s2r_spec.effects import Change, ModelEffect, sets, with_prior_scale
from s2r_spec.errors import UsageError, one_of, suggest

FAMILY = "own"
"""Definition: family of an effect that the user adds."""


class ParameterChange(Table):
    """Changes of a parameter of an effect; with ``field`` a new one."""

    range: Range | None = None
    prior: float | None = Field(default=None, gt=0.0)
    field: str = ""
    how: Literal["set", "add", "scale"] = "set"
    unit: str | None = None


class _Content(Table):
    """The file; its other keys are effects."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, bool | dict[str, Literal[False] | ParameterChange]]

    kinds: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    parameters: str = ""

    @property
    def effects(self) -> dict[str, bool | dict[str, Literal[False] | ParameterChange]]:
        """Effect → whether it is there, or its parameters."""
        return self.model_extra or {}


@dataclass(frozen=True)
class OwnEffects:
    """What a user's file says of a catalogue.

    Attributes:
        path: the file; None for no file, which changes nothing.
        content: its content.
        strict: whether an effect that the catalogue lacks is a mistake; a robot in the air lacks those of its base.
    """

    path: Path | None = None
    content: _Content = field(default_factory=partial(_Content.model_validate, {}))
    strict: bool = True

    @classmethod
    def read(cls, path: Path, strict: bool) -> OwnEffects:
        """Read a file; with ``strict``, a name that the catalogue lacks is a mistake.

        Raises:
            UsageError: the file is missing, is not TOML, or has a wrong key or value.
        """
        table = read_toml(path, "catalogue of effects")
        return cls(path, checked(_Content, table, path, ParameterChange), strict)

    @property
    def files(self) -> tuple[Path, ...]:
        """The file."""
        return () if self.path is None else (self.path,)

    @property
    def code_names(self) -> tuple[str, ...]:
        """The object of the user's own code, with an absolute path."""
        name = self.content.parameters
        return (str(self.path.parent.resolve() / name),) if name and self.path is not None else ()

    def kinds_of(self, model: Any) -> dict[str, list[int]]:
        """Return kind → its joints.

        Raises:
            UsageError: an expression fits no joint, a joint has two kinds, or a kind has hinges and slides.
        """
        found: dict[str, list[int]] = {}
        for name, patterns in self.content.kinds.items():
            place = f"{self.name}: kinds.{name}"
            if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) or not patterns:
                raise UsageError(f"{place} must be a name of letters, digits and _, with a list of joints")
            found[name] = by_patterns(model, patterns, place)
            if len({int(model.jnt_type[joint]) for joint in found[name]}) > 1:
                raise UsageError(f"{place} has hinges and slides; make a kind of each")
            for other in found:
                both = [joint for joint in found[name] if joint in found[other] and other != name]
                if both:
                    raise UsageError(f"{place}: the joint {name_of(model, both[0])} is in kinds.{other}, too")
        taken = {joint for own in found.values() for joint in own}
        for joint in scalar_joints(model):
            kind = kind_name(name_of(model, joint))
            if joint not in taken and kind in found:
                raise UsageError(
                    f"{self.name}: kinds.{kind} leaves out {name_of(model, joint)}, whose kind has this name; "
                    f"choose another name"
                )
        return found

    def changed(
        self, effects: Sequence[ModelEffect], file: ModelFile, model: Any
    ) -> tuple[tuple[ModelEffect, ...], tuple[Edit, ...]]:
        """Return the catalogue of the user, and how its new effects change the model's description.

        Raises:
            UsageError: the file does not fit the catalogue or the model.
        """
        by_name = {one.name: one for one in effects}
        own = _Own(self, file, model, by_name)
        for name, wanted in self.content.effects.items():
            own.change(name, wanted)
        for name in self.code_names:
            own.add_parameters(name)
        kept = [one for one in by_name.values() if one.parameters]
        return (
            tuple(one for one in kept if one.name not in RARE or self.content.effects.get(one.name)),
            tuple(own.edits),
        )

    @property
    def name(self) -> str:
        """Name of the file; "" for none."""
        return "" if self.path is None else self.path.name


class _Own:
    """Changes a catalogue, name → effect, and collects how its new effects change the model's description."""

    def __init__(
        self, file: OwnEffects, source: ModelFile, model: Any, effects: dict[str, ModelEffect]
    ) -> None:
        self._name, self._strict = file.name, file.strict
        self._source, self._model, self._effects = source, model, effects
        self.edits: list[Edit] = []

    def change(self, name: str, wanted: bool | Mapping[str, Literal[False] | ParameterChange]) -> None:
        """Apply what the file says of an effect."""
        tables = {} if isinstance(wanted, bool) else wanted
        new = bool(tables) and all(one and one.field for one in tables.values())
        if name not in self._effects and not new:
            if self._strict:
                raise UsageError(
                    f"{self._name}: {name} is no effect of this robot{suggest(name, self._effects)} it has "
                    f"{one_of(self._effects)}; one of your own needs a field for each parameter"
                )
            return
        if wanted is False:
            del self._effects[name]
        elif name not in self._effects:
            self._effects[name] = ModelEffect.of(name, FAMILY, f"An effect of {self._name}.")
        for key, table in tables.items():
            self._change(name, key, table)

    def _change(self, name: str, key: str, table: Literal[False] | ParameterChange) -> None:
        effect, place = self._effects[name], f"{self._name}: {name}.{key}"
        known = {one.name: one for one in effect.parameters}
        if table and table.field:
            if key in known:
                raise UsageError(f"{place}: the effect has this parameter already; choose another name")
            self._effects[name] = self._with_field(effect, key, table, place)
            return
        if key not in known:
            raise UsageError(
                f"{place}: the effect has no parameter {key!r}{suggest(key, known)} it has {one_of(known)}"
            )
        rows = []
        for parameter, change in zip(effect.parameters, effect.changes, strict=True):
            if not table and key in (parameter.name, parameter.beside):
                continue
            rows.append(
                (_changed(parameter, table, place) if table and parameter.name == key else parameter, change)
            )
        self._effects[name] = replace(
            effect, parameters=tuple(one for one, _ in rows), changes=tuple(change for _, change in rows)
        )

    def _with_field(self, effect: ModelEffect, key: str, table: ParameterChange, place: str) -> ModelEffect:
        if table.range is None:
            raise UsageError(f"{place}: a new parameter needs a range, such as range = [0, 1]")
        for name in (effect.name, key):
            if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
                raise UsageError(f"{place}: {name!r} is not a name of letters, digits and _")
        stated = ParameterTable(field=table.field, how=table.how, unit=table.unit, range=table.range)
        try:
            one = of_field(key, stated, self._source, self._model, place).declared
        except UsageError as error:
            words = str(error)
            raise UsageError(words if words.startswith(place) else f"{place}: {words}") from None
        plain = EffectParameter(key, one.unit, one.low, one.high, one.default, "uniform over the range")
        limits = ParameterChange(prior=table.prior, range=table.range)
        change = FieldChange(table.field, table.how)

        def write(spec: Any, numbers: FloatArray) -> None:
            self._source.change(spec, change, float(numbers[0]))

        (made,) = self._add(np.array([one.default]), write)
        return replace(
            effect,
            parameters=(*effect.parameters, _changed(plain, limits, place)),
            changes=(*effect.changes, made),
        )

    def _add(self, nominal: FloatArray, write: Callable[[Any, FloatArray], None]) -> Iterator[Change]:
        """Add numbers, and return what sets each."""
        first = self.edits[-1].at.stop if self.edits else 0
        self.edits.append(Edit(slice(first, first + nominal.size), nominal, write))
        return (sets("amounts", first + k) for k in range(nominal.size))

    def add_parameters(self, code: str) -> None:
        """Add the parameters of a ``ParameterDict``, or of what a function returns that makes one."""
        value, label = load_code(code).value, f"{self._name}: parameters"
        found = value() if callable(value) else value
        if not callable(getattr(found, "items", None)):
            raise UsageError(f"{label}: {Path(code).name} is no ParameterDict of mujoco.sysid")
        plain = self._source.compile()
        for name, one in found.items():
            place, effect = f"{label}: {name}", re.sub(r"\W", "_", name)
            if effect in self._effects:
                raise UsageError(f"{place} has the name of an effect of the catalogue; choose another")
            if not _is_fixed(one, place):
                words = f"The parameter {name} of {Path(code).name}."
                self._effects[effect] = self._of_parameter(effect, words, one, place, plain)

    def _of_parameter(self, name: str, words: str, one: Any, place: str, plain: Any) -> ModelEffect:
        """Return the effect of a parameter of ``mujoco.sysid``; ``plain`` is the compiled model without it."""
        nominal, low, high = (
            np.asarray(row, dtype=np.float64).ravel() for row in (one.nominal, one.min_value, one.max_value)
        )
        write = partial(_modify, one)
        if changed := differences(plain, self._source.compile(edit=partial(write, numbers=nominal))):
            raise UsageError(
                f"{place}: its nominal value {nominal.tolist()} changes {changed[0]} of the model; make the nominal "
                f"value the model's own"
            )
        names = ["value"] if nominal.size == 1 else [f"value_{k}" for k in range(nominal.size)]
        rows = [
            (key, "", float(a), float(b), float(at), "uniform within the bounds", change)
            for key, a, b, at, change in zip(
                names, low, high, nominal, self._add(nominal, write), strict=True
            )
        ]
        return ModelEffect.of(name, FAMILY, words, *rows)


def _is_fixed(parameter: Any, place: str) -> bool:
    """Return whether a parameter is frozen; a UsageError if it is none of ``mujoco.sysid``, or has no modifier."""
    if not all(hasattr(parameter, word) for word in ("nominal", "min_value", "max_value", "frozen")):
        raise UsageError(f"{place} is no Parameter of mujoco.sysid")
    if not parameter.frozen and getattr(parameter, "modifier", None) is None:
        raise UsageError(f"{place} has no modifier, so nothing says what it changes in the model")
    return bool(parameter.frozen)


def _modify(parameter: Any, spec: Any, numbers: FloatArray) -> None:
    """Apply a parameter of ``mujoco.sysid`` with other numbers; its own value stays."""
    mine = copy.deepcopy(parameter)  # a shallow copy loses the modifier
    mine.value = numbers.reshape(np.shape(parameter.nominal))
    mine.modifier(spec, mine)


def _changed(parameter: EffectParameter, table: ParameterChange, place: str) -> EffectParameter:
    """Return a parameter with another range and another scale of its prior."""
    low, high = table.range or (parameter.low, parameter.high)
    if not low < high or not low <= parameter.nominal <= high:
        raise UsageError(
            f"{place}: the range {[low, high]} must have two different ends around {parameter.nominal:g}, at which the "
            f"effect does nothing"
        )
    made = replace(parameter, low=low, high=high)
    return made if table.prior is None else with_prior_scale(made, table.prior)
