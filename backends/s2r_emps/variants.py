"""Variants of the axis: models that are as valid as the nominal one.

Their differences from the nominal model do not cause a gap, and a diagnosis ignores differences of their size.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi

from s2r_emps.noise import Noise
from s2r_emps.physics import MOTOR_SHARE, Physics

RESONANCE = 150.0
"""Resonance of the carriage on its screw with the motor locked [Hz]; machine tools have 100 to 250 Hz."""


def variants(physics: Physics, noise: Noise) -> dict[str, tuple[Physics, Noise]]:
    """Return name → physics and noise with one idealisation replaced by another."""
    carriage = (1.0 - MOTOR_SHARE) * physics.mass
    compliance = 1.0 / (carriage * (2.0 * pi * RESONANCE) ** 2)
    return {
        "a screw that yields": (replace(physics, compliance=physics.compliance + compliance), noise),
        "twice the noise": (
            physics,
            replace(noise, encoder=2.0 * noise.encoder, disturbance=2.0 * noise.disturbance),
        ),
    }
