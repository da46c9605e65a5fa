"""Strength that decays with time."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, rate: float, by_load: float) -> Physics:
    return replace(physics, fade=physics.fade + rate, fade_by_load=physics.fade_by_load + by_load)


STRENGTH_DECAY = PhysicsEffect(
    name="strength_decay",
    family="actuation",
    physics=(
        "The motors lose this part of their strength in every second from the command on, as with "
        "an emptying battery. The part by_load of the loss grows with the squared torques instead of time."
    ),
    parameters=(
        EffectParameter("rate", "1/s", low=0.0, high=0.3, nominal=0.0, prior="half-normal, 0.05 1/s"),
        EffectParameter("by_load", "", low=0.0, high=1.0, nominal=0.0, prior="uniform"),
    ),
    apply=_apply,
)
