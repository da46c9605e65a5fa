"""Weak motors: lost power, warm magnets, a driver's current limit."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, factor: float) -> Physics:
    return replace(physics, strength=physics.strength * factor)


MOTOR_STRENGTH = PhysicsEffect(
    name="motor_strength",
    family="actuation",
    physics=(
        "The motors deliver this fraction of the torque command, and reach their limit that much earlier."
    ),
    parameters=(
        EffectParameter(
            "factor", "", low=0.3, high=1.2, nominal=1.0, prior="normal around 1, standard deviation 0.15"
        ),
    ),
    apply=_apply,
)
