"""Actuation latency: bus, firmware and current loop."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, delay: float) -> Physics:
    return replace(physics, latency=physics.latency + delay)


LATENCY = PhysicsEffect(
    name="latency",
    family="timing",
    physics="Motor commands take effect this much later, in whole physics steps of 1 ms.",
    parameters=(
        EffectParameter("delay", "s", low=0.0, high=0.03, nominal=0.0, prior="half-normal, 0.006 s"),
    ),
    apply=_apply,
)
