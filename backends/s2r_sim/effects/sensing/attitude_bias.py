"""A biased attitude."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, roll: float, pitch: float) -> Physics:
    about_x, about_y = physics.attitude_bias
    return replace(physics, attitude_bias=(about_x + roll, about_y + pitch))


ATTITUDE_BIAS = PhysicsEffect(
    name="attitude_bias",
    family="sensing",
    physics="The IMU is misaligned on the trunk, and reports roll and pitch with these errors.",
    parameters=(
        EffectParameter("roll", "deg", low=-6.0, high=6.0, nominal=0.0, prior="normal, 1.5 deg"),
        EffectParameter("pitch", "deg", low=-6.0, high=6.0, nominal=0.0, prior="normal, 1.5 deg"),
    ),
    apply=_apply,
)
