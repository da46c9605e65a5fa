"""A biased velocity estimate."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, forward: float, left: float) -> Physics:
    x, y = physics.velocity_bias
    return replace(physics, velocity_bias=(x + forward, y + left))


VELOCITY_BIAS = PhysicsEffect(
    name="velocity_bias",
    family="sensing",
    physics="The controller's velocity has this error, in the heading frame.",
    parameters=(
        EffectParameter("forward", "m/s", low=-0.15, high=0.15, nominal=0.0, prior="normal, 0.03 m/s"),
        EffectParameter("left", "m/s", low=-0.15, high=0.15, nominal=0.0, prior="normal, 0.03 m/s"),
    ),
    apply=_apply,
)
