"""Calibration errors of the joint encoders."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, hip: float, thigh: float, calf: float) -> Physics:
    a, b, c = physics.encoder_offset
    return replace(physics, encoder_offset=(a + hip, b + thigh, c + calf))


ENCODER_OFFSET = PhysicsEffect(
    name="encoder_offset",
    family="sensing",
    physics=(
        "Joint encoders, for the controller and for the motors' own loop, are off by these angles "
        "on all legs."
    ),
    parameters=(
        EffectParameter("hip", "rad", low=-0.08, high=0.08, nominal=0.0, prior="normal, 0.02 rad"),
        EffectParameter("thigh", "rad", low=-0.08, high=0.08, nominal=0.0, prior="normal, 0.02 rad"),
        EffectParameter("calf", "rad", low=-0.08, high=0.08, nominal=0.0, prior="normal, 0.02 rad"),
    ),
    apply=_apply,
)
