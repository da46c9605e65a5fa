"""A velocity estimate of the wrong scale."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, factor: float) -> Physics:
    return replace(physics, velocity_scale=physics.velocity_scale * factor)


VELOCITY_SCALE = PhysicsEffect(
    name="velocity_scale",
    family="sensing",
    physics="The controller's velocity is multiplied by this factor.",
    parameters=(
        EffectParameter(
            "factor", "", low=0.7, high=1.4, nominal=1.0, prior="normal around 1, standard deviation 0.1"
        ),
    ),
    apply=_apply,
)
