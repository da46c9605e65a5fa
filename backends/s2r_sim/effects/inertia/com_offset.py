"""An offset of the trunk's centre of mass."""

from __future__ import annotations

from dataclasses import replace

from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.plant.physics import Physics
from s2r_spec.backend import EffectParameter


def _apply(physics: Physics, x: float, y: float, z: float) -> Physics:
    cx, cy, cz = physics.com_shift
    return replace(physics, com_shift=(cx + x, cy + y, cz + z))


COM_OFFSET = PhysicsEffect(
    name="com_offset",
    family="inertia",
    physics="The trunk's centre of mass lies elsewhere than the controller's model has it.",
    parameters=(
        EffectParameter("x", "m", low=-0.1, high=0.1, nominal=0.0, prior="normal, 0.02 m"),
        EffectParameter("y", "m", low=-0.06, high=0.06, nominal=0.0, prior="normal, 0.01 m"),
        EffectParameter("z", "m", low=-0.06, high=0.06, nominal=0.0, prior="normal, 0.01 m"),
    ),
    apply=_apply,
)
