"""An effect: its catalogue entry, and a function from one table of physics to another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from s2r_sim.plant.physics import Physics
from s2r_spec.backend import Effect


@dataclass(frozen=True)
class PhysicsEffect(Effect):
    """An effect of this simulator.

    ``apply(physics, **values)`` changes only fields of its own, or multiplies a
    field or adds to it, so that the order of effects has no influence. At nominal
    values it returns an equal table.
    """

    apply: Callable[..., Physics]
