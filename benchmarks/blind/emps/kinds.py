"""What can be wrong with the axis: the members of the catalogue, and what the catalogue does not have.

Sizes run from just material, which moves ρ by several times its scatter somewhere
in the test space or is plain in the voltage, to about four times that; what they
do to ρ is printed by benchmarks/blind/emps_compare.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi

from numpy.random import Generator

Numbers = dict[str, float]
Make = Callable[[float, Generator], tuple[Numbers, Numbers]]
Where = Callable[[Mapping[str, float]], dict[str, list[float]]]


@dataclass(frozen=True)
class Kind:
    """One effect.

    Attributes:
        name: the catalogue's, where it is in the catalogue.
        low, high: of its size, log-uniform between.
        signed: whether it can be negative.
        made: (size, generator) → fields of the machine that it changes, and the label's values.
        relative_of: the catalogue member that it resembles.
        where: fields → where it acts: ``window`` in s or ``place`` in m.
    """

    name: str
    low: float
    high: float
    made: Make
    signed: bool = False
    relative_of: str | None = None
    where: Where | None = None


def plain(field: str, label: str) -> Make:
    """Return what makes an effect of one number, which is a field as it stands."""
    return lambda size, rng: ({field: size}, {label: size})


def _stribeck(size: float, rng: Generator) -> tuple[Numbers, Numbers]:
    speed = 0.02 * float(rng.lognormal(0.0, 0.4))
    return {"stribeck": size, "stribeck_speed": speed}, {"force": size, "speed": speed}


def _wave(field: str, phase: str) -> Make:
    def made(size: float, rng: Generator) -> tuple[Numbers, Numbers]:
        angle = float(rng.uniform(-pi, pi))
        return {field: size, phase: angle}, {"amplitude": size, "phase": angle}

    return made


def _delay(size: float, rng: Generator) -> tuple[Numbers, Numbers]:
    return {"delay": size, "jitter": float(rng.uniform(0.1, 0.4))}, {"time": size}


def _kind(name: str, high: float, made: Make, signed: bool = False) -> Kind:
    return Kind(name, 0.25 * high, high, made, signed)


_KNOWN = (
    _kind("viscous", 400.0, plain("viscous", "coefficient")),
    _kind("coulomb", 50.0, plain("coulomb", "force")),
    Kind("stribeck", 30.0, 75.0, _stribeck),
    _kind("quadratic_drag", 2500.0, plain("quadratic", "coefficient")),
    _kind("load_friction", 0.25, plain("load_friction", "coefficient")),
    _kind("offset", 35.0, plain("offset", "force"), signed=True),
    _kind("cable", 600.0, plain("cable", "stiffness")),
    _kind("mass", 30.0, lambda x, rng: ({"mass": 95.0 + x}, {"extra": x}), signed=True),
    _kind("motor_gain", 0.25, lambda x, rng: ({"gain": 1.0 + x}, {"factor": 1.0 + x}), signed=True),
    _kind("force_ripple", 40.0, _wave("force_ripple", "force_phase")),
    _kind("current_lag", 0.003, plain("lag", "time")),
    _kind("supply_sag", 0.5, plain("sag", "drop")),
    # The test space asks for at most 7.2 V: less than 3 V off the plate does not show.
    Kind("voltage_limit", 3.2, 5.0, lambda x, rng: ({"limit": 10.0 - x}, {"voltage": 10.0 - x})),
    _kind("delay", 0.003, _delay),
    _kind("speed_filter", 0.003, plain("speed_filter", "time")),
    _kind("encoder_ripple", 5e-5, _wave("encoder_ripple", "encoder_phase")),
    _kind("backlash", 2e-4, plain("half_gap", "half_gap")),
)  # fmt: skip
KNOWN: dict[str, Kind] = {kind.name: kind for kind in _KNOWN}
"""The catalogue's members, in other forms."""


def _placed(field: str, label: str) -> Make:
    def made(size: float, rng: Generator) -> tuple[Numbers, Numbers]:
        place = float(rng.uniform(0.08, 0.16))
        return {field: size, "place": place}, {label: size, "place": place}

    return made


def _timed(field: str, label: str) -> Make:
    def made(size: float, rng: Generator) -> tuple[Numbers, Numbers]:
        since = float(rng.uniform(0.4, 1.5))
        return {field: size, "since": since}, {label: size, "since": since}

    return made


def _flexible(size: float, rng: Generator) -> tuple[Numbers, Numbers]:
    frequency = float(rng.uniform(5.0, 12.0))
    return {"flexible": size, "frequency": frequency}, {"mass": size, "frequency": frequency}


def _at(half: float) -> Where:
    return lambda values: {"place": [values["place"] - half, values["place"] + half]}


def _for(seconds: float) -> Where:
    return lambda values: {"window": [values["since"], values["since"] + seconds]}


UNLIKE: tuple[Kind, ...] = (
    Kind("flexible_payload", 6.0, 30.0, _flexible),
    Kind("bump", 15.0, 70.0, _placed("bump", "force"), where=_at(0.01)),
    Kind("sticking_spot", 15.0, 70.0, _placed("sticking", "force"), where=_at(0.008)),
    Kind("gust", 25.0, 100.0, _timed("gust", "force"), signed=True, where=_for(0.35)),
    Kind("late_brake", 10.0, 50.0, _timed("brake", "force"), where=_for(2.5)),
    Kind("outages", 0.002, 0.01, plain("outages", "probability")),
    Kind("lost_counts", 2e-5, 1e-4, _placed("slipped", "distance"), where=_at(0.005)),
)
"""Structurally different from everything in the catalogue."""

NEAR: tuple[Kind, ...] = (
    Kind("cubic_drag", 2500.0, 12000.0, plain("cubic", "coefficient"), relative_of="quadratic_drag"),
    Kind("shear_thinning", 12.0, 60.0, plain("thinning", "force"), relative_of="coulomb"),
    Kind("root_stribeck", 15.0, 70.0, plain("root_stribeck", "force"), relative_of="stribeck"),
    Kind("graded_coulomb", 100.0, 500.0, plain("graded", "slope"), relative_of="coulomb"),
    Kind("warming_grease", 120.0, 600.0, plain("warming", "coefficient"), relative_of="viscous"),
    Kind("one_sided_cable", 250.0, 1200.0, plain("one_sided", "stiffness"), relative_of="cable"),
    Kind("lopsided_gain", 0.05, 0.25, plain("lopsided_gain", "share"), relative_of="motor_gain"),
)
"""A member of the catalogue with another law."""
