"""Shear creep under load, as on sand."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, stiffness: float) -> Physics:
    return replace(physics, impratio=physics.impratio * stiffness)


SHEAR_CREEP = PhysicsEffect(
    name="shear_creep",
    family="contact",
    physics=(
        "Friction builds up more slowly under a loaded foot by this factor on its stiffness, so "
        "that the foot creeps."
    ),
    parameters=(EffectParameter("stiffness", "", low=0.01, high=1.0, nominal=1.0, prior="log-uniform"),),
    apply=_apply,
)
