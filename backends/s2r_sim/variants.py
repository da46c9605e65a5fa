"""The same robot under other numerical settings and idealisations.

Each variant is as good a model of an A1 on a floor as the nominal one. The differences between them belong to the
simulator, so that a diagnosis does not explain a difference of their size.
"""

from __future__ import annotations

from dataclasses import fields, replace

from s2r_sim.plant.noise import Noise
from s2r_sim.robot.constants import Inertia
from s2r_sim.settings import Settings

MASS_ERROR = 0.015
"""Relative uncertainty of a link's mass (dimensionless)."""
_INITIAL = ("initial", "gait")
INSTRUMENTS = {
    "capture_position": 2e-4,
    "capture_speed": 1e-3,
    "foot_position": 3e-4,
    "foot_speed": 1e-3,
    "foot_force": 1.0,
    "torque": 0.05,
}
"""Prior: noise of a laboratory's instruments, in the units of :class:`Noise`. A judgement, of the order of data sheets:
a few tenths of a millimetre for motion capture, 1 N for force plates, 0.15 % of the largest torque."""


def variants(settings: Settings, noise: Noise) -> dict[str, tuple[Settings, Noise]]:
    """Return name → settings and noise with one idealisation exchanged for another."""
    p = settings.physics
    physics = {
        "half the step": replace(p, timestep=p.timestep / 2),
        "fewer solver iterations": replace(p, iterations=max(p.iterations // 4, 1)),
        "softer friction": replace(p, impratio=p.impratio / 5),
        "softer ground": replace(p, sink=p.sink + 0.0015),
        "more torsion": replace(p, torsion=3.0 * p.torsion),
        "joints that rub less": replace(p, damping=0.2 * p.damping, dry_friction=0.2 * p.dry_friction),
    }
    robot, light = settings.robot, 1.0 - MASS_ERROR
    heavier = replace(robot, trunk=_scale(robot.trunk, 1.0 + MASS_ERROR))
    lighter = replace(heavier, thigh=_scale(robot.thigh, light), calf=_scale(robot.calf, light))
    louder = {f.name: 2.0 * getattr(noise, f.name) for f in fields(noise) if not f.name.startswith(_INITIAL)}
    return {name: (replace(settings, physics=changed), noise) for name, changed in physics.items()} | {
        "lighter legs, heavier trunk": (replace(settings, robot=lighter), noise),
        "twice the sensor noise": (settings, replace(noise, **louder)),
        "measured by instruments": (settings, replace(noise, **INSTRUMENTS)),
    }


def _scale(inertia: Inertia, factor: float) -> Inertia:
    moments = {name: getattr(inertia, name) * factor for name in ("mass", "xx", "yy", "zz", "xy", "xz", "yz")}
    return replace(inertia, **moments)
