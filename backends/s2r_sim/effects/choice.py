"""Which effects are added to a simulator, and how much of each."""

from __future__ import annotations

from collections.abc import Mapping

from s2r_sim.effects import CATALOGUE
from s2r_sim.plant.physics import Physics
from s2r_spec.errors import UsageError, did_you_mean, one_of

Values = Mapping[str, Mapping[str, float]]
Choice = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""Effects and their values in a fixed order, so that equal choices are equal and hash alike."""


def choose(before: Choice, values: Values) -> Choice:
    """Return the choice with these values added; what was set before stays unless set again.

    Raises:
        UsageError: an effect or a parameter is unknown, or a value out of range.
    """
    chosen = {name: dict(pairs) for name, pairs in before}
    for name, settings in values.items():
        if name not in CATALOGUE:
            raise UsageError(
                f"the backend 'sim' has no effect {name!r}{did_you_mean(name, CATALOGUE)}; "
                f"it has {one_of(CATALOGUE)}"
            )
        known = {parameter.name: parameter for parameter in CATALOGUE[name].parameters}
        for key, value in settings.items():
            if key not in known:
                raise UsageError(
                    f"the effect {name!r} has no parameter {key!r}{did_you_mean(key, known)}; "
                    f"it has {one_of(known)}"
                )
            parameter = known[key]
            if not parameter.low <= value <= parameter.high:
                raise UsageError(
                    f"{name}: {key} = {value:g} {parameter.unit} is out of range: "
                    f"[{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
                )
            chosen.setdefault(name, {})[key] = float(value)
    return tuple((name, tuple(sorted(chosen[name].items()))) for name in sorted(chosen))


def world(nominal: Physics, choice: Choice) -> Physics:
    """Return the world with these effects in it; a parameter that is not set is nominal."""
    physics = nominal
    for name, pairs in choice:
        effect = CATALOGUE[name]
        values = {parameter.name: parameter.nominal for parameter in effect.parameters} | dict(pairs)
        physics = effect.apply(physics, **values)
    return physics
