"""The catalogue as axes through the nominal simulator: one a parameter of an effect."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.backend.effects import prior_scale

Values = Mapping[str, Mapping[str, float]]

TURN = {"rad": 2.0 * math.pi, "deg": 360.0}
"""Definition: unit of an angle → a whole turn. An angle whose range is a turn has no ends."""


@dataclass(frozen=True)
class EffectAxis:
    """One parameter of one effect, varied while the effect's others stay put.

    Attributes:
        effect, parameter, unit: names, and the unit of the parameter.
        nominal: the value that does nothing.
        typical: a distance from nominal that is large, but not rare, in the coordinate that is stepped; half a turn of
            an angle that may be any.
        low, high: ends of the parameter's range.
        logarithmic: whether that coordinate is the parameter's logarithm.
        base: other parameters of the effect that are held off nominal, so that this one acts at all.
    """

    effect: str
    parameter: str
    unit: str
    nominal: float
    typical: float
    low: float
    high: float
    logarithmic: bool = False
    base: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """``payload.mass``."""
        return f"{self.effect}.{self.parameter}"

    def coordinate(self, value: float) -> float:
        """Return the distance of a value from nominal, as a part of the typical one."""
        far = math.log(value / self.nominal) if self.logarithmic else value - self.nominal
        return far / self.typical

    @property
    def ends(self) -> tuple[float, float]:
        """The coordinates of the ends of the range, rising."""
        one, other = self.coordinate(self.low), self.coordinate(self.high)
        return min(one, other), max(one, other)

    def value(self, coordinate: float) -> float:
        """Return the value at this coordinate."""
        far = coordinate * self.typical
        value = self.nominal * math.exp(far) if self.logarithmic else self.nominal + far
        if self.is_turn:
            value = self.low + (value - self.low) % (self.high - self.low)
        return min(max(value, self.low), self.high)

    def interval(self, middle: float, low: float, high: float) -> tuple[float, float, float]:
        """Return the values at three rising coordinates; of an angle, the outer two may lie beyond its range."""
        if not self.is_turn:
            return self.value(middle), self.value(low), self.value(high)
        value = self.value(middle)
        return value, value - (middle - low) * self.typical, value + (high - middle) * self.typical

    @property
    def is_turn(self) -> bool:
        """Whether it is an angle whose range is a whole turn, so that both ends are the same place."""
        turn = TURN.get(self.unit, math.nan)
        return abs(self.high - self.low - turn) < 1e-3 * turn

    @property
    def is_phase(self) -> bool:
        """Whether it is an angle that may be any and only says how the effect acts, as the phase of a ripple does."""
        return self.is_turn and bool(self.base)

    def stands_beside(self, other: EffectAxis) -> bool:
        """Whether it only says how another parameter acts."""
        return other.effect == self.effect and other.parameter in self.base

    def at_typical(self) -> float:
        """Return the value that is typically high, on the upper side if there is one."""
        return self.value(1.0 if self.high > self.nominal else -1.0)

    def coordinates(self, points: Iterable[float]) -> list[float]:
        """Return coordinates, rising: of the ends of the range, and these on either side, as far as it reaches."""
        low, high = self.coordinate(self.low), self.coordinate(self.high)
        inside = {sign * point for sign in (-1.0, 1.0) for point in points if low < sign * point < high}
        return sorted((inside | {low, high}) - {0.0})

    def at(self, value: float) -> dict[str, dict[str, float]]:
        """Return what :meth:`HasEffects.with_effects` takes."""
        return {self.effect: {**self.base, self.parameter: float(value)}}


def effect_axis(
    effect: Effect, parameter: EffectParameter, base: Mapping[str, float] | None = None
) -> EffectAxis:
    """Return the axis of one parameter, by its logarithm for a prior that says so ("log-uniform").

    Typical is twice the prior's standard deviation, where its text has one, or two thirds of the larger side of the
    range, and never more than that side.
    """
    logarithmic = parameter.prior.startswith("log") and parameter.low > 0
    low, high, middle = (
        math.log(x) if logarithmic else float(x) for x in (parameter.low, parameter.high, parameter.nominal)
    )
    reach, scale = max(abs(low - middle), abs(high - middle)), prior_scale(parameter)
    made = EffectAxis(
        effect.name,
        parameter.name,
        parameter.unit,
        parameter.nominal,
        min(2.0 * (min(scale, reach) if scale else reach / 3.0), reach),
        parameter.low,
        parameter.high,
        logarithmic,
        dict(base or {}),
    )
    return replace(made, typical=(made.high - made.low) / 2.0) if made.is_turn else made


def effect_axes(
    effects: Iterable[Effect], acts: Mapping[str, frozenset[str]] | None = None
) -> tuple[EffectAxis, ...]:
    """Return every axis of a catalogue.

    ``acts`` is effect → parameters that change something while the effect's others are nominal, when that was tried;
    the rest of its parameters are varied with the first of these off nominal.
    """
    out = []
    for effect in effects:
        able = (acts or {}).get(effect.name, frozenset(p.name for p in effect.parameters))
        acting = [p for p in effect.parameters if p.name in able]
        out += [effect_axis(effect, parameter) for parameter in acting]
        if acting:
            # These only say how the first acts, and come after it, whatever the catalogue's order is.
            by_name = {p.name: p for p in acting}
            for p in effect.parameters:
                if p.name not in able:
                    first = by_name.get(p.beside, acting[0])
                    out.append(effect_axis(effect, p, {first.name: effect_axis(effect, first).at_typical()}))
    return tuple(out)
