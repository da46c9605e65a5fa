"""A slope that the controller's model does not have."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, angle: float) -> Physics:
    return replace(physics, slope=physics.slope + angle)


SLOPE = PhysicsEffect(
    name="slope",
    family="terrain",
    physics="The ground is tilted by this angle, uphill in the direction in which the robot starts.",
    parameters=(EffectParameter("angle", "deg", low=-8.0, high=8.0, nominal=0.0, prior="normal, 2 deg"),),
    apply=_apply,
)
