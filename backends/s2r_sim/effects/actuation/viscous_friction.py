"""Viscous friction of grease and seals."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, coefficient: float) -> Physics:
    return replace(physics, damping=physics.damping + coefficient)


VISCOUS_FRICTION = PhysicsEffect(
    name="viscous_friction",
    family="actuation",
    physics="Friction proportional to speed is added to every joint.",
    parameters=(
        EffectParameter(
            "coefficient", "N*m*s/rad", low=0.0, high=2.0, nominal=0.0, prior="half-normal, 0.4 N*m*s/rad"
        ),
    ),
    apply=_apply,
)
