"""The catalogue of effects: physics that the nominal simulator omits. A family has a folder, an effect a file."""

from __future__ import annotations

from s2r_sim.effects.actuation.backlash import BACKLASH
from s2r_sim.effects.actuation.dry_friction import DRY_FRICTION
from s2r_sim.effects.actuation.motor_strength import MOTOR_STRENGTH
from s2r_sim.effects.actuation.strength_decay import STRENGTH_DECAY
from s2r_sim.effects.actuation.torque_constant import TORQUE_CONSTANT
from s2r_sim.effects.actuation.torque_speed_line import TORQUE_SPEED_LINE
from s2r_sim.effects.actuation.viscous_friction import VISCOUS_FRICTION
from s2r_sim.effects.contact.foot_drag import FOOT_DRAG
from s2r_sim.effects.contact.ground_friction import GROUND_FRICTION
from s2r_sim.effects.contact.shear_creep import SHEAR_CREEP
from s2r_sim.effects.contact.soft_ground import SOFT_GROUND
from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.effects.inertia.armature import ARMATURE
from s2r_sim.effects.inertia.com_offset import COM_OFFSET
from s2r_sim.effects.inertia.payload import PAYLOAD
from s2r_sim.effects.sensing.attitude_bias import ATTITUDE_BIAS
from s2r_sim.effects.sensing.encoder_offset import ENCODER_OFFSET
from s2r_sim.effects.sensing.velocity_bias import VELOCITY_BIAS
from s2r_sim.effects.sensing.velocity_scale import VELOCITY_SCALE
from s2r_sim.effects.terrain.roughness import ROUGHNESS
from s2r_sim.effects.terrain.slope import SLOPE
from s2r_sim.effects.timing.latency import LATENCY
from s2r_sim.plant.physics import Physics
from s2r_spec.effects import Choice, settings

CATALOGUE: dict[str, PhysicsEffect] = {
    effect.name: effect
    for effect in (
        MOTOR_STRENGTH,
        STRENGTH_DECAY,
        TORQUE_SPEED_LINE,
        LATENCY,
        DRY_FRICTION,
        VISCOUS_FRICTION,
        ARMATURE,
        BACKLASH,
        GROUND_FRICTION,
        SOFT_GROUND,
        FOOT_DRAG,
        SHEAR_CREEP,
        SLOPE,
        ROUGHNESS,
        PAYLOAD,
        COM_OFFSET,
        VELOCITY_BIAS,
        VELOCITY_SCALE,
        ATTITUDE_BIAS,
        ENCODER_OFFSET,
        TORQUE_CONSTANT,
    )
}


def with_effects(nominal: Physics, choice: Choice) -> Physics:
    """Return the physics with these effects added; a parameter that is not set is nominal."""
    physics = nominal
    for name, values in settings(CATALOGUE.values(), choice).items():
        physics = CATALOGUE[name].apply(physics, **values)
    return physics
