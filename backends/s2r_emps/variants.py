"""The same axis, idealised otherwise: what of a trace is the simulator's doing.

Each is as good a model of an axis with a screw as the nominal one, and nobody's
cause of a gap. A diagnosis believes no difference that is as large as theirs.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi

from s2r_emps.noise import Noise
from s2r_emps.physics import MOTOR_SHARE, Physics

RESONANCE = 150.0
"""[Hz] of the carriage on its screw, with the motor held; those of machine tools are at 100 to 250 Hz."""


def variants(physics: Physics, noise: Noise) -> dict[str, tuple[Physics, Noise]]:
    """Return name → physics and noise with one idealisation exchanged for another."""
    carriage = (1.0 - MOTOR_SHARE) * physics.mass
    compliance = 1.0 / (carriage * (2.0 * pi * RESONANCE) ** 2)
    return {
        "a screw that yields": (replace(physics, compliance=physics.compliance + compliance), noise),
        "twice the noise": (
            physics,
            replace(noise, encoder=2.0 * noise.encoder, disturbance=2.0 * noise.disturbance),
        ),
    }
