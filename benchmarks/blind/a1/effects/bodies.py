"""Effects on masses."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

from numpy.random import Generator

from benchmarks.blind.a1.effects.kind import Kind, Values
from benchmarks.blind.a1.twin import Twin


def _load(twin: Twin, rng: Generator, values: Values) -> None:
    """A box of even density, welded to the trunk."""
    at = (values["x"], values["y"], 0.08 + 0.01 * rng.normal())
    twin.build = replace(twin.build, payload=values["mass"], payload_at=at)


def _where(rng: Generator, mass: float) -> dict[str, float]:
    """Return a payload, in the middle or off it."""
    if rng.uniform() < 0.5:
        return {"mass": mass, "x": 0.0, "y": 0.0}
    return {"mass": mass, "x": rng.uniform(-0.12, 0.12), "y": rng.uniform(-0.05, 0.05)}


def _battery(twin: Twin, rng: Generator, values: Values) -> None:
    """A part of the trunk sits elsewhere, which moves the centre and widens the inertia."""
    twin.build = replace(twin.build, battery=(values["x"], values["y"], values["z"]))


def _shift(rng: Generator, size: float) -> dict[str, float]:
    """Return a shift that is mostly along or across; half as far to the side."""
    angle = rng.uniform(0.0, 2.0 * pi)
    if rng.uniform() < 0.6:
        angle = rng.choice((0.0, pi))
    return {"x": size * cos(angle), "y": 0.5 * size * sin(angle), "z": 0.0}


BODIES = (
    Kind("payload", 0.4, 4.0, _where, _load),
    Kind("com_offset", 0.01, 0.06, _shift, _battery),
)
