"""The catalogue of effects: physics that the nominal simulator omits. A family has a file, an effect a declaration."""

from __future__ import annotations

from s2r_sim.effects.actuation import (
    BACKLASH,
    DRY_FRICTION,
    MOTOR_STRENGTH,
    STRENGTH_DECAY,
    TORQUE_CONSTANT,
    TORQUE_SPEED_LINE,
    VISCOUS_FRICTION,
)
from s2r_sim.effects.contact import FOOT_DRAG, GROUND_FRICTION, SHEAR_CREEP, SOFT_GROUND
from s2r_sim.effects.inertia import ARMATURE, COM_OFFSET, PAYLOAD
from s2r_sim.effects.sensing import ATTITUDE_BIAS, ENCODER_OFFSET, VELOCITY_BIAS, VELOCITY_SCALE
from s2r_sim.effects.terrain import ROUGHNESS, SLOPE
from s2r_sim.effects.timing import LATENCY
from s2r_sim.plant.physics import Physics
from s2r_spec.effects import Choice, ModelEffect, add_effects

CATALOGUE: dict[str, ModelEffect] = {
    effect.name: effect
    for effect in (
        MOTOR_STRENGTH, STRENGTH_DECAY, TORQUE_SPEED_LINE, LATENCY, DRY_FRICTION, VISCOUS_FRICTION, ARMATURE, BACKLASH,
        GROUND_FRICTION, SOFT_GROUND, FOOT_DRAG, SHEAR_CREEP, SLOPE, ROUGHNESS,
        PAYLOAD, COM_OFFSET, VELOCITY_BIAS, VELOCITY_SCALE, ATTITUDE_BIAS, ENCODER_OFFSET, TORQUE_CONSTANT,
    )
}  # fmt: skip


def with_effects(nominal: Physics, choice: Choice) -> Physics:
    """Return the physics with these effects added; a parameter that is not set is nominal."""
    return add_effects(nominal, CATALOGUE.values(), choice)
