"""What the robot measures and what the lab logs: errors of sensors, with their own random numbers."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, radians, sqrt

import numba
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.a1.world import RATE

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Sensing:
    """Systematic errors of the sensors.

    Attributes:
        velocity_bias: [m/s] forward and left.
        velocity_scale: a factor.
        velocity_drift: [m/s^2] by which the forward bias grows from the command on.
        attitude_bias: [deg] roll and pitch.
    """

    velocity_bias: tuple[float, float] = (0.0, 0.0)
    velocity_scale: float = 1.0
    velocity_drift: float = 0.0
    attitude_bias: tuple[float, float] = (0.0, 0.0)


def coloured(rng: Generator, ticks: int, width: int, deviation: float, time: float) -> FloatArray:
    """Return (ticks, width) of a first-order Gauss–Markov process of this deviation and time constant [s]."""
    values = rng.normal(size=(ticks, width)) * deviation
    _carry_on(values, exp(-1.0 / (RATE * time)))
    return values


@numba.njit(cache=True)
def _carry_on(values, keep):  # type: ignore[no-untyped-def]
    for now in range(1, values.shape[0]):
        for column in range(values.shape[1]):
            values[now, column] = (
                keep * values[now - 1, column] + sqrt(1.0 - keep * keep) * values[now, column]
            )


@dataclass(frozen=True)
class Errors:
    """What the sensors add in one rollout.

    Attributes:
        added: (ticks, 36) to the true state with rotors in place of joints; the velocity's own part comes first.
        scale: (ticks,) of the fed-back velocity.
        bias: (ticks, 2) of it, forward and left [m/s]; scale and bias are also in the robot's own estimate.
        force: (ticks, 3) of the accelerometer [m/s^2].
        lasting: (ticks, 36) the part of ``added`` that is no noise: of the IMU's attitude and rates.
    """

    added: FloatArray
    scale: FloatArray
    bias: FloatArray
    force: FloatArray
    lasting: FloatArray


def errors(sensing: Sensing, rng: Generator, ticks: int, settling: int) -> Errors:
    """Draw the errors of a rollout whose command comes after ``settling`` ticks."""
    added, lasting = np.zeros((ticks, 36)), np.zeros((ticks, 36))
    added[:, 0:3] = coloured(rng, ticks, 3, 0.0002, 0.02)
    added[:, 3:6] = rng.normal(size=(ticks, 3)) * 0.0015 + coloured(rng, ticks, 3, 0.0008, 0.02)
    added[:, 6:9] = rng.normal(size=(ticks, 3)) * 0.008 + coloured(rng, ticks, 3, 0.003, 0.01)
    added[:, 9:12] = rng.normal(size=(ticks, 3)) * 0.008
    lasting[:, 9:12] = rng.normal(size=3) * 0.002
    added[:, 12:24] = rng.uniform(-0.0015, 0.0015, (ticks, 12))
    added[:, 24:36] = rng.uniform(-0.09, 0.09, (ticks, 12))
    clock = (np.arange(ticks) - settling) / RATE
    roll, pitch = sensing.attitude_bias
    size = radians(abs(roll) + abs(pitch))
    lasting[:, 3:5] = np.radians([roll, pitch]) + 0.05 * size * clock[:, None] * rng.normal(size=2)
    added += lasting
    wander = coloured(rng, ticks, 2, 1.0, 0.6)
    bias = np.array(sensing.velocity_bias)
    bias = bias + 0.1 * np.hypot(*bias) * wander
    bias[:, 0] += sensing.velocity_drift * np.maximum(clock, 0.0)
    scale = 1.0 + (sensing.velocity_scale - 1.0) * (1.0 + 0.1 * coloured(rng, ticks, 1, 1.0, 0.6)[:, 0])
    force = rng.normal(size=(ticks, 3)) * 0.08 + coloured(rng, ticks, 3, 0.05, 0.05)
    return Errors(added, scale, bias, force, lasting)


def off(sensing: Sensing, ticks: int) -> Errors:
    """Return the errors without anything random, for the warm-up."""
    added = np.zeros((ticks, 36))
    added[:, 3:5] += np.radians(sensing.attitude_bias)
    return Errors(
        added,
        np.full(ticks, sensing.velocity_scale),
        np.tile(np.array(sensing.velocity_bias), (ticks, 1)),
        np.zeros((ticks, 3)),
        added,
    )
