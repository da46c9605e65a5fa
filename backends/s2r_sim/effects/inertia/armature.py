"""Rotor inertia seen through the gear."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, inertia: float) -> Physics:
    return replace(physics, armature=physics.armature + inertia)


ARMATURE = PhysicsEffect(
    name="armature",
    family="inertia",
    physics="Rotor inertia is added to every joint, beyond that of the controller's model.",
    parameters=(
        EffectParameter(
            "inertia", "kg*m^2", low=0.0, high=0.03, nominal=0.0, prior="half-normal, 0.008 kg*m^2"
        ),
    ),
    apply=_apply,
)
