"""Play between motor and joint."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, half_gap: float) -> Physics:
    return replace(physics, backlash=physics.backlash + half_gap)


BACKLASH = PhysicsEffect(
    name="backlash",
    family="actuation",
    physics=("Between the flanks of its gear a rotor turns freely, and encoders sit on the rotor's side."),
    parameters=(
        EffectParameter("half_gap", "rad", low=0.0, high=0.05, nominal=0.0, prior="half-normal, 0.01 rad"),
    ),
    apply=_apply,
)
