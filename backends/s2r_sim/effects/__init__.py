"""The catalogue of effects: physics that the nominal simulator leaves out, one small file each."""

from __future__ import annotations

from s2r_sim.effects.armature import ARMATURE
from s2r_sim.effects.attitude_bias import ATTITUDE_BIAS
from s2r_sim.effects.backlash import BACKLASH
from s2r_sim.effects.com_offset import COM_OFFSET
from s2r_sim.effects.dry_friction import DRY_FRICTION
from s2r_sim.effects.effect import PhysicsEffect
from s2r_sim.effects.encoder_offset import ENCODER_OFFSET
from s2r_sim.effects.foot_drag import FOOT_DRAG
from s2r_sim.effects.ground_friction import GROUND_FRICTION
from s2r_sim.effects.latency import LATENCY
from s2r_sim.effects.motor_strength import MOTOR_STRENGTH
from s2r_sim.effects.payload import PAYLOAD
from s2r_sim.effects.roughness import ROUGHNESS
from s2r_sim.effects.shear_creep import SHEAR_CREEP
from s2r_sim.effects.slope import SLOPE
from s2r_sim.effects.soft_ground import SOFT_GROUND
from s2r_sim.effects.strength_decay import STRENGTH_DECAY
from s2r_sim.effects.torque_constant import TORQUE_CONSTANT
from s2r_sim.effects.torque_speed_line import TORQUE_SPEED_LINE
from s2r_sim.effects.velocity_bias import VELOCITY_BIAS
from s2r_sim.effects.velocity_scale import VELOCITY_SCALE
from s2r_sim.effects.viscous_friction import VISCOUS_FRICTION

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
