"""A payload on the trunk."""

from __future__ import annotations

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import PAYLOAD_HEIGHT, Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, mass: float, x: float, y: float, z: float) -> Physics:
    return physics.with_payload(mass, x, y, z)


PAYLOAD = PhysicsEffect(
    name="payload",
    family="inertia",
    physics="A point mass sits on the trunk, at x, y and z from the base origin.",
    parameters=(
        EffectParameter("mass", "kg", low=0.0, high=6.0, nominal=0.0, prior="half-normal, 1.5 kg"),
        EffectParameter("x", "m", low=-0.15, high=0.15, nominal=0.0, prior="normal, 0.05 m"),
        EffectParameter("y", "m", low=-0.1, high=0.1, nominal=0.0, prior="normal, 0.03 m"),
        EffectParameter(
            "z",
            "m",
            low=0.0,
            high=0.25,
            nominal=PAYLOAD_HEIGHT,
            prior="normal around 0.08, standard deviation 0.04",
        ),
    ),
    apply=_apply,
)
