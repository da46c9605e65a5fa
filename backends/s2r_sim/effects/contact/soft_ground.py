"""Soft ground: turf, carpet, loose soil."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, sink: float) -> Physics:
    return replace(physics, sink=physics.sink + sink)


SOFT_GROUND = PhysicsEffect(
    name="soft_ground",
    family="contact",
    physics="The ground builds up its resistance over this depth instead of at once.",
    parameters=(EffectParameter("sink", "m", low=0.0, high=0.03, nominal=0.0, prior="half-normal, 0.01 m"),),
    apply=_apply,
)
