"""The shape of the ground: a slope, and smooth random unevenness upon it."""

from __future__ import annotations

from math import atan, cos, hypot, pi, radians, sin, sqrt, tan
from typing import NamedTuple

import numpy as np

from s2r_sim.physics import Physics

_WAVES = 24
_LENGTHS = (0.2, 0.6)
"""[m] shortest and longest wavelength."""


class _Wave(NamedTuple):
    kx: float
    ky: float
    phase: float


def _waves() -> tuple[_Wave, ...]:
    rng = np.random.default_rng(1)
    length, heading, phase = (
        rng.uniform(_LENGTHS[0], _LENGTHS[1], _WAVES),
        *rng.uniform(0, 2 * pi, (2, _WAVES)),
    )
    k = 2 * pi / length
    waves = zip((k * np.cos(heading)).tolist(), (k * np.sin(heading)).tolist(), phase.tolist(), strict=True)
    return tuple(_Wave(*wave) for wave in waves)


_UNEVEN = _waves()


def mean_height(physics: Physics, x: float) -> float:
    """Return the height of the slope [m]."""
    return x * tan(radians(physics.slope))


def surface(
    physics: Physics, x: float, y: float, amplitude: float, origin: tuple[float, float]
) -> tuple[float, float, float]:
    """Return height [m] and its derivatives along x and y.

    A sum of plane waves of random direction, length and phase; ``amplitude`` in
    [0, 1] scales it, so that it can grow under a robot that stands on the flat;
    ``origin`` [m] is the place on it that lies at the world's origin.
    """
    scale = amplitude * physics.roughness * sqrt(2.0 / _WAVES)
    height, slope_x, slope_y = mean_height(physics, x), tan(radians(physics.slope)), 0.0
    if scale == 0.0:
        return height, slope_x, slope_y
    for kx, ky, phase in _UNEVEN:
        angle = kx * (x + origin[0]) + ky * (y + origin[1]) + phase
        height += scale * cos(angle)
        slope_x -= scale * kx * sin(angle)
        slope_y -= scale * ky * sin(angle)
    return height, slope_x, slope_y


def plane_attitude(slope_x: float, slope_y: float) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) that turns z into the normal of a plane of these slopes."""
    steepness = hypot(slope_x, slope_y)
    if steepness == 0.0:
        return (1.0, 0.0, 0.0, 0.0)
    half = atan(steepness) / 2
    return (cos(half), slope_y / steepness * sin(half), -slope_x / steepness * sin(half), 0.0)
