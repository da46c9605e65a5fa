"""Uneven ground."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, height: float) -> Physics:
    return replace(physics, roughness=physics.roughness + height)


ROUGHNESS = PhysicsEffect(
    name="roughness",
    family="terrain",
    physics=(
        "The ground's height varies smoothly, with wavelengths of 0.2 to 0.6 m and this standard "
        "deviation. The seed of a rollout chooses the place where it begins."
    ),
    parameters=(
        EffectParameter("height", "m", low=0.0, high=0.015, nominal=0.0, prior="half-normal, 0.004 m"),
    ),
    apply=_apply,
)
