"""Effects of the shape of the ground: a slope, and unevenness."""

from __future__ import annotations

from s2r_spec.backend import EffectParameter
from s2r_spec.effects import ModelEffect, adds

SLOPE = ModelEffect(
    "slope", "terrain", "The ground is tilted by this angle, uphill in the direction in which the robot starts.",
    (EffectParameter("angle", "deg", low=-8.0, high=8.0, nominal=0.0, prior="normal, 2 deg"),),
    (adds("slope"),),
)  # fmt: skip
ROUGHNESS = ModelEffect(
    "roughness", "terrain",
    "The ground's height varies smoothly, with wavelengths of 0.2 to 0.6 m and this standard deviation. The seed of a "
    "rollout chooses the place where it begins.",
    (EffectParameter("height", "m", low=0.0, high=0.015, nominal=0.0, prior="half-normal, 0.004 m"),),
    (adds("roughness"),),
)  # fmt: skip
