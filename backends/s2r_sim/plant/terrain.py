"""The shape of the ground: a slope with smooth random unevenness."""

from __future__ import annotations

from math import atan, cos, hypot, pi, radians, sin, sqrt, tan

import numpy as np

from s2r_sim.plant.physics import Physics
from s2r_sim.robot.constants import FloatArray
from s2r_spec.compiled import compiled

_WAVES = 24
_LENGTHS = (0.2, 0.6)
"""[m] shortest and longest wavelength."""


def _waves() -> FloatArray:
    """Return (waves, 3): wave number along x and along y [rad/m], and phase [rad]."""
    rng = np.random.default_rng(1)
    length, heading, phase = (
        rng.uniform(_LENGTHS[0], _LENGTHS[1], _WAVES),
        *rng.uniform(0, 2 * pi, (2, _WAVES)),
    )
    k = 2 * pi / length
    return np.column_stack([k * np.cos(heading), k * np.sin(heading), phase])


_UNEVEN = _waves()


def mean_height(physics: Physics, x: float) -> float:
    """Return the height of the slope [m]."""
    return x * tan(radians(physics.slope))


def surface(
    physics: Physics, x: float, y: float, amplitude: float, origin: tuple[float, float]
) -> tuple[float, float, float]:
    """Return height [m] and its derivatives along x and y.

    The unevenness is a sum of plane waves of random direction, length and phase.
    ``amplitude`` in [0, 1] scales it, so that it can grow under a robot on flat
    ground. ``origin`` [m] is the point of it that lies at the world's origin.
    """
    scale = amplitude * physics.roughness * sqrt(2.0 / _WAVES)
    height, slope_x, slope_y = mean_height(physics, x), tan(radians(physics.slope)), 0.0
    if scale == 0.0:
        return height, slope_x, slope_y
    return _add_waves(_UNEVEN, scale, x + origin[0], y + origin[1], height, slope_x)


def covariance(dx: FloatArray, dy: FloatArray) -> FloatArray:
    """Return the covariance of the heights of two places, (dx, dy) [m] apart, on ground of unit roughness."""
    kx, ky, _ = _UNEVEN.T
    apart = np.multiply.outer(dx, kx) + np.multiply.outer(dy, ky)
    return np.cos(apart).mean(axis=-1)


@compiled
def _add_waves(
    waves: FloatArray, scale: float, x: float, y: float, height: float, slope_x: float
) -> tuple[float, float, float]:
    slope_y = 0.0
    for k in range(waves.shape[0]):
        kx, ky = waves[k, 0], waves[k, 1]
        angle = kx * x + ky * y + waves[k, 2]
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
