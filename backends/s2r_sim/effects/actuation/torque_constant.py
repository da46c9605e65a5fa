"""An error of the motors' torque constant."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, factor: float) -> Physics:
    return replace(physics, torque_constant=physics.torque_constant * factor)


TORQUE_CONSTANT = PhysicsEffect(
    name="torque_constant",
    family="actuation",
    physics=(
        "The same current makes this multiple of the assumed torque; torque reported from the "
        "current does not show it."
    ),
    parameters=(
        EffectParameter(
            "factor", "", low=0.6, high=1.3, nominal=1.0, prior="normal around 1, standard deviation 0.1"
        ),
    ),
    apply=_apply,
)
