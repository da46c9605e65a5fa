"""The voltage-limited torque-speed line of an electric motor."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, voltage: float) -> Physics:
    return replace(physics, voltage=min(physics.voltage, voltage))


TORQUE_SPEED_LINE = PhysicsEffect(
    name="torque_speed_line",
    family="actuation",
    physics=(
        "At a part v of the supply voltage the driving torque is at most 2 (v - |speed| / 21 rad/s) "
        "of its maximum. At v = 1 there is no such limit."
    ),
    parameters=(
        EffectParameter("voltage", "", low=0.2, high=1.0, nominal=1.0, prior="1 minus half-normal, 0.2"),
    ),
    apply=_apply,
)
