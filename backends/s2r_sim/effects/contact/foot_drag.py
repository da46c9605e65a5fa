"""Drag on low feet, as in tall grass."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, coefficient: float) -> Physics:
    return replace(physics, drag=physics.drag + coefficient)


FOOT_DRAG = PhysicsEffect(
    name="foot_drag",
    family="contact",
    physics=("A foot less than 6 cm above the ground is held back by a force proportional to its velocity."),
    parameters=(
        EffectParameter(
            "coefficient", "N*s/m", low=0.0, high=20.0, nominal=0.0, prior="half-normal, 5 N*s/m"
        ),
    ),
    apply=_apply,
)
