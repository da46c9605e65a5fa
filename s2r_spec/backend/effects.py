"""Added effects of a backend, by name, and the scales of their priors; shared by all backends with a catalogue.

A :data:`Choice` is a value: two choices with the same effects are equal and have the same hash, in any order of
addition. A backend stores one, and calls :func:`settings` for its numbers when it builds a model.

If all physical constants are fields of one frozen dataclass, an effect is a declaration: a :class:`ModelEffect` says
which field each parameter changes, and how. :func:`add_effects` then builds the model.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from s2r_spec.backend import Backend, Effect, EffectParameter, HasChosen, HasEffects
from s2r_spec.base.documentation import page
from s2r_spec.base.errors import BackendError, UsageError, did_you_mean, one_of

Values = Mapping[str, Mapping[str, float]]
"""Effect → parameter → value."""
Choice = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""The same in a fixed order, with only the set parameters."""
_SCALE = re.compile(
    r"(?:deviation |normal\b[^,]*, *)(?P<scale>\d*\.?\d+(?:[eE][-+]?\d+)?) *(?P<unit>.*)", re.IGNORECASE
)
_NORMAL = re.compile(r"\bnormal\b|\bdeviation\b", re.IGNORECASE)
_Model = TypeVar("_Model")


@dataclass(frozen=True)
class Change:
    """How the value of a parameter changes one field of a model; made by :func:`adds`, :func:`scales` and others.

    Attributes:
        field: name of the field, which holds a number, a tuple of numbers or an array of any shape.
        combine: returns the new number from the old one and the value, which has the unit that the field needs.
        at: components that change, as NumPy indexes them: ``2``, ``[2, 5]``, ``slice(2, None, 3)``; ``...`` for all.
    """

    field: str
    combine: Callable[[Any, float], Any]
    at: Any = ...

    def of(self, before: Any, value: float) -> Any:
        """Return the new content of the field, in the type and shape of the old one, which stays unchanged."""
        after = np.array(before, dtype=np.float64)
        after[self.at] = self.combine(after[self.at], value)
        if isinstance(before, np.ndarray):
            return after
        return tuple(after.tolist()) if isinstance(before, tuple) else after.item()


def adds(field: str, at: Any = ...) -> Change:
    """Return the change that adds the value, in the field's unit; nominal is 0."""
    return Change(field, operator.add, at)


def scales(field: str, at: Any = ...) -> Change:
    """Return the change that multiplies by the value, a factor; nominal is 1."""
    return Change(field, operator.mul, at)


def limits(field: str, at: Any = ...) -> Change:
    """Return the change that takes the lower of field and value, both in the field's unit; nominal is the field."""
    return Change(field, np.minimum, at)


def sets(field: str, at: Any = ...) -> Change:
    """Return the change to the value, in the field's unit; only one effect of a catalogue may set a field."""
    return Change(field, _value, at)


def _value(before: Any, value: float) -> float:
    return value


@dataclass(frozen=True)
class ModelEffect(Effect):
    """An effect that changes fields of a model; ``changes`` has one change for each parameter, in their order."""

    changes: tuple[Change, ...] = ()

    @classmethod
    def of(cls, name: str, family: str, physics: str, *rows: tuple[Any, ...]) -> Self:
        """Return an effect from rows of a table: the six fields of a parameter, and the change that it makes."""
        parameters = tuple(EffectParameter(*row[:6]) for row in rows)
        return cls(name, family, physics, parameters, tuple(change for row in rows for change in row[6:]))

    def apply(self, model: Any, **values: float) -> Any:
        """Return a copy of a frozen dataclass with the effect in it; ``values`` has every parameter."""
        for parameter, change in zip(self.parameters, self.changes, strict=True):
            field = change.of(getattr(model, change.field), values[parameter.name])
            model = replace(model, **{change.field: field})
        return model


def add_effects(model: _Model, catalogue: Iterable[ModelEffect], choice: Choice) -> _Model:
    """Return a model, a frozen dataclass, with the chosen effects; a parameter that is not set is nominal."""
    by_name = {effect.name: effect for effect in catalogue}
    for name, values in settings(by_name.values(), choice).items():
        model = by_name[name].apply(model, **values)
    return model


def choose(backend: str, catalogue: Iterable[Effect], before: Choice, values: Values) -> Choice:
    """Return a choice with these values added; values set before stay unless they are set again.

    Args:
        backend: name of the backend, for messages.
        catalogue: all effects of the backend.
        before: the choice so far, ``()`` at first.
        values: effect → parameter → value, in the units of the catalogue.

    Raises:
        UsageError: an effect or a parameter is unknown, or a value out of range.
    """
    known = {effect.name: {p.name: p for p in effect.parameters} for effect in catalogue}
    chosen = as_values(before)
    for name, numbers in values.items():
        if name not in known:
            raise UsageError(
                f"the backend {backend!r} has no effect {name!r}{did_you_mean(name, known)}; it has {one_of(known)}"
            )
        for key, value in numbers.items():
            if key not in known[name]:
                raise UsageError(
                    f"the effect {name!r} has no parameter {key!r}{did_you_mean(key, known[name])}; "
                    f"it has {one_of(known[name])}"
                )
            parameter = known[name][key]
            if not parameter.low <= value <= parameter.high:
                unit = f" {parameter.unit}" if parameter.unit else ""
                raise UsageError(
                    f"{name}: {key} = {value:g}{unit} is out of range: [{parameter.low:g}, {parameter.high:g}]{unit}"
                )
            chosen.setdefault(name, {})[key] = float(value)
    return tuple((name, tuple(sorted(chosen[name].items()))) for name in sorted(chosen))


def settings(catalogue: Iterable[Effect], choice: Choice) -> dict[str, dict[str, float]]:
    """Return effect → parameter → value of the chosen effects; parameters that were not set are nominal."""
    nominal = {effect.name: {p.name: p.nominal for p in effect.parameters} for effect in catalogue}
    return {name: nominal[name] | values for name, values in as_values(choice).items()}


def as_values(choice: Choice) -> dict[str, dict[str, float]]:
    """Return effect → parameter → value, for the parameters that were set.

    Raises:
        UsageError: the choice is a string: the text after the colon in the name of a backend that has no options.
    """
    if isinstance(choice, str):
        raise UsageError(
            f"this backend has no options, so it cannot read {choice!r}; leave out the colon and the text after it"
        )
    return {name: dict(pairs) for name, pairs in choice}


def read_word(word: str) -> Values | None:
    """Return the values that ``coulomb.force=20`` sets; None for a word without an effect (``reference=a.mat``).

    Raises:
        UsageError: the text after the equals sign is not a number.
    """
    name, _, text = word.partition("=")
    effect, dot, parameter = name.partition(".")
    if not dot:
        return None
    try:
        return {effect: {parameter: float(text)}}
    except ValueError:
        raise UsageError(
            f"{word!r}: {text!r} is not a number; write effect.parameter=value, such as {name}=1"
        ) from None


def words(choice: Choice) -> list[str]:
    """Return a choice as words that :func:`read_word` reads."""
    return [f"{effect}.{parameter}={value!r}" for effect, values in choice for parameter, value in values]


def catalogue_of(backend: Backend) -> tuple[Effect, ...]:
    """Return the declared effects of a backend; an added effect has its reported value as nominal.

    Raises:
        UsageError: the backend declares no effects, so no cause can be named.
        BackendError: a parameter has no range around its nominal value, or its prior has no scale.
    """
    if not isinstance(backend, HasEffects) or not backend.effects():
        raise UsageError(
            f"the backend {backend.name!r} declares no effects, so s2r cannot name a cause; "
            f"see {page('how-to/effects')}"
        )
    chosen = backend.chosen() if isinstance(backend, HasChosen) else {}
    return tuple(_check(backend.name, effect, chosen.get(effect.name, {})) for effect in backend.effects())


def _check(backend: str, effect: Effect, chosen: Mapping[str, float]) -> Effect:
    """Return the effect with its added values as nominal ones."""
    for p in effect.parameters:
        if not (p.low <= p.nominal <= p.high and p.low < p.high and math.isfinite(p.high - p.low)):
            raise BackendError(
                f"backend {backend!r}: the effect {effect.name!r} has {p.name!r} in [{p.low:g}, {p.high:g}] with the "
                f"nominal value {p.nominal:g}; declare finite ends, low < high, and a nominal value between them"
            )
        if _NORMAL.search(p.prior) and not prior_scale(p):
            raise BackendError(
                f"backend {backend!r}: the effect {effect.name!r} has {p.name!r} with the prior {p.prior!r} without a "
                f"scale; write 'half-normal, 20 N' or 'normal around 1, standard deviation 0.1'"
            )
    parameters = tuple(replace(p, nominal=float(chosen.get(p.name, p.nominal))) for p in effect.parameters)
    return replace(effect, parameters=parameters)


def with_prior_scale(parameter: EffectParameter, scale: float) -> EffectParameter:
    """Return the parameter with another scale in the prior's text; normal around nominal, where it had none."""
    match = _SCALE.search(parameter.prior)
    if match is None:
        text = f"normal around {parameter.nominal:g}, standard deviation {scale:g} {parameter.unit}".strip()
    else:
        text = f"{parameter.prior[: match.start('scale')]}{scale:g}{parameter.prior[match.end('scale') :]}"
    return replace(parameter, prior=text)


def prior_scale(parameter: EffectParameter) -> float:
    """Return the scale in the prior's text, in the parameter's unit; 0 if there is none."""
    match = _SCALE.search(parameter.prior)
    return float(match["scale"]) if match and match["unit"].strip() in ("", parameter.unit) else 0.0
