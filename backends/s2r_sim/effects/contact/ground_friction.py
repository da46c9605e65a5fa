"""Another friction coefficient of the ground."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, factor: float) -> Physics:
    return replace(physics, friction=physics.friction * factor)


GROUND_FRICTION = PhysicsEffect(
    name="ground_friction",
    family="contact",
    physics="The friction coefficient of foot on ground is multiplied by this factor.",
    parameters=(
        EffectParameter("factor", "", low=0.1, high=1.5, nominal=1.0, prior="log-normal around 1, 0.4"),
    ),
    apply=_apply,
)
