"""Sensors of the smooth plant: 16-bit encoders, a low-passed gyro, an attitude that wanders slowly."""

from __future__ import annotations

from math import exp, radians

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.plants.machine import Machine
from benchmarks.plants.robot import RATE
from benchmarks.plants.rollout import carried

FloatArray = NDArray[np.float64]

GYRO_TIME = 0.002
"""Definition: time constant of the gyro's filter [s], 80 Hz. Twice as much delays measured rates by 2 ms more."""
GYRO, GYRO_BIAS, ATTITUDE, VELOCITY, POSITION, ACCELEROMETER = 0.008, 0.002, 0.0015, 0.008, 0.0003, 0.08
"""Definitions: standard deviations [rad/s], [rad/s], [rad], [m/s], [m], [m/s²]."""
ATTITUDE_TIME, VELOCITY_TIME = 0.3, 0.02
"""Definitions: correlation times of attitude, and of position and velocity [s]."""


class Senses:
    """The sensors of one run; see :class:`benchmarks.plants.rollout.Senses`."""

    def __init__(self, machine: Machine, rng: Generator, ticks: int) -> None:
        self._rng, self._noise = rng, machine.noise
        errors = np.zeros((ticks, 12))
        errors[:, 0:3] = POSITION * carried(rng.normal(size=(ticks, 3)), VELOCITY_TIME)
        errors[:, 3:6] = ATTITUDE * carried(rng.normal(size=(ticks, 3)), ATTITUDE_TIME)
        errors[:, 6:9] = VELOCITY * carried(rng.normal(size=(ticks, 3)), VELOCITY_TIME)
        errors[:, 9:12] = GYRO * rng.normal(size=(ticks, 3)) + GYRO_BIAS * rng.normal(size=3)
        self._errors = machine.noise * errors
        self._errors[:, 3:5] += (
            radians(machine["attitude_bias.roll"]),
            radians(machine["attitude_bias.pitch"]),
        )
        self._rate: FloatArray | None = None
        self._tick = 0

    def read(self, truth: FloatArray, encoders: FloatArray) -> FloatArray:
        spin = truth[9:12]
        if self._rate is None:
            self._rate = spin.copy()
        self._rate += (1.0 - exp(-1.0 / (RATE * GYRO_TIME))) * (spin - self._rate)
        seen = np.concatenate((truth[:9], self._rate, encoders))
        seen[:12] += self._errors[self._tick]
        self._tick += 1
        return seen

    def accelerometer(self, ticks: int) -> FloatArray:
        return self._noise * ACCELEROMETER * self._rng.normal(size=(ticks, 3))

    def instrument(self, ticks: int, width: int, deviation: float) -> FloatArray:
        return deviation * self._rng.normal(size=(ticks, width))
