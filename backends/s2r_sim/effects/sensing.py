"""Effects of sensors and of the velocity estimate: offsets, biases and wrong scales."""

from __future__ import annotations

from s2r_spec.backend import EffectParameter
from s2r_spec.effects import ModelEffect, adds, scales

VELOCITY_BIAS = ModelEffect(
    "velocity_bias", "sensing", "The controller's velocity has this error, in the heading frame.",
    (
        EffectParameter("forward", "m/s", low=-0.15, high=0.15, nominal=0.0, prior="normal, 0.03 m/s"),
        EffectParameter("left", "m/s", low=-0.15, high=0.15, nominal=0.0, prior="normal, 0.03 m/s"),
    ),
    (adds("velocity_bias", 0), adds("velocity_bias", 1)),
)  # fmt: skip
VELOCITY_SCALE = ModelEffect(
    "velocity_scale", "sensing", "The controller's velocity is multiplied by this factor.",
    (EffectParameter("factor", "", low=0.7, high=1.4, nominal=1.0, prior="normal around 1, standard deviation 0.1"),),
    (scales("velocity_scale"),),
)  # fmt: skip
ATTITUDE_BIAS = ModelEffect(
    "attitude_bias", "sensing", "The IMU is misaligned on the trunk, and reports roll and pitch with these errors.",
    (
        EffectParameter("roll", "deg", low=-6.0, high=6.0, nominal=0.0, prior="normal, 1.5 deg"),
        EffectParameter("pitch", "deg", low=-6.0, high=6.0, nominal=0.0, prior="normal, 1.5 deg"),
    ),
    (adds("attitude_bias", 0), adds("attitude_bias", 1)),
)  # fmt: skip
ENCODER_OFFSET = ModelEffect(
    "encoder_offset", "sensing",
    "Joint encoders, for the controller and for the motors' own loop, are off by these angles on all legs.",
    (
        EffectParameter("hip", "rad", low=-0.08, high=0.08, nominal=0.0, prior="normal, 0.02 rad"),
        EffectParameter("thigh", "rad", low=-0.08, high=0.08, nominal=0.0, prior="normal, 0.02 rad"),
        EffectParameter("calf", "rad", low=-0.08, high=0.08, nominal=0.0, prior="normal, 0.02 rad"),
    ),
    (adds("encoder_offset", 0), adds("encoder_offset", 1), adds("encoder_offset", 2)),
)  # fmt: skip
