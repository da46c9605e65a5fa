"""Dry friction of gears and bearings."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, torque: float) -> Physics:
    return replace(physics, dry_friction=physics.dry_friction + torque)


DRY_FRICTION = PhysicsEffect(
    name="dry_friction",
    family="actuation",
    physics="Coulomb friction of this torque is added to every joint.",
    parameters=(
        EffectParameter("torque", "N*m", low=0.0, high=2.0, nominal=0.0, prior="half-normal, 0.5 N*m"),
    ),
    apply=_apply,
)
