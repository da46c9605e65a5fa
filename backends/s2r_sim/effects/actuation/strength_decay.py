"""Strength that decays with time."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, rate: float) -> Physics:
    return replace(physics, fade=physics.fade + rate)


STRENGTH_DECAY = PhysicsEffect(
    name="strength_decay",
    family="actuation",
    physics=(
        "The motors lose this part of their strength in every second from the command on, as with "
        "an emptying battery."
    ),
    parameters=(
        EffectParameter("rate", "1/s", low=0.0, high=0.3, nominal=0.0, prior="half-normal, 0.05 1/s"),
    ),
    apply=_apply,
)
