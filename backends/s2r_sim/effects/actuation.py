"""Effects of motors and gears: strength, friction, play, and errors of the reported torque."""

from __future__ import annotations

from s2r_spec.backend import EffectParameter
from s2r_spec.effects import ModelEffect, adds, limits, scales

MOTOR_STRENGTH = ModelEffect(
    "motor_strength", "actuation",
    "The motors deliver this fraction of the torque command, and reach their limit that much earlier.",
    (EffectParameter("factor", "", low=0.3, high=1.2, nominal=1.0, prior="normal around 1, standard deviation 0.15"),),
    (scales("strength"),),
)  # fmt: skip
STRENGTH_DECAY = ModelEffect(
    "strength_decay", "actuation",
    "The motors lose this part of their strength in every second from the command on, as with an emptying battery. "
    "The part by_load of the loss grows with the squared torques instead of time.",
    (
        EffectParameter("rate", "1/s", low=0.0, high=0.3, nominal=0.0, prior="half-normal, 0.05 1/s"),
        EffectParameter("by_load", "", low=0.0, high=1.0, nominal=0.0, prior="uniform"),
    ),
    (adds("fade"), adds("fade_by_load")),
)  # fmt: skip
TORQUE_SPEED_LINE = ModelEffect(
    "torque_speed_line", "actuation",
    "At a part v of the supply voltage the driving torque is at most 2 (v - |speed| / 21 rad/s) of its maximum. "
    "At v = 1 there is no such limit.",
    (EffectParameter("voltage", "", low=0.2, high=1.0, nominal=1.0, prior="1 minus half-normal, 0.2"),),
    (limits("voltage"),),
)  # fmt: skip
DRY_FRICTION = ModelEffect(
    "dry_friction", "actuation", "Coulomb friction of this torque is added to every joint.",
    (EffectParameter("torque", "N*m", low=0.0, high=2.0, nominal=0.0, prior="half-normal, 0.5 N*m"),),
    (adds("dry_friction"),),
)  # fmt: skip
VISCOUS_FRICTION = ModelEffect(
    "viscous_friction", "actuation", "Friction proportional to speed is added to every joint.",
    (EffectParameter("coefficient", "N*m*s/rad", low=0.0, high=2.0, nominal=0.0, prior="half-normal, 0.4 N*m*s/rad"),),
    (adds("damping"),),
)  # fmt: skip
BACKLASH = ModelEffect(
    "backlash", "actuation",
    "Between the flanks of its gear a rotor turns freely, and encoders sit on the rotor's side.",
    (EffectParameter("half_gap", "rad", low=0.0, high=0.05, nominal=0.0, prior="half-normal, 0.01 rad"),),
    (adds("backlash"),),
)  # fmt: skip
TORQUE_CONSTANT = ModelEffect(
    "torque_constant", "actuation",
    "The same current makes this multiple of the assumed torque; torque reported from the current does not show it.",
    (EffectParameter("factor", "", low=0.6, high=1.3, nominal=1.0, prior="normal around 1, standard deviation 0.1"),),
    (scales("torque_constant"),),
)  # fmt: skip
