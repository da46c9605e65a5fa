"""Sensors of the stiff plant: coloured noise everywhere, and a ninth of it white."""

from __future__ import annotations

from math import radians

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.plants.machine import Machine
from benchmarks.plants.rollout import carried

FloatArray = NDArray[np.float64]

COLOURED = np.repeat((0.0003, 0.0018, 0.0015, 0.009, 0.010, 0.0006, 0.03), (3, 2, 1, 3, 3, 12, 12))
"""Definitions: (36,) standard deviations of a measured state [m], [rad], [m/s], [rad/s]; joints [rad], [rad/s]."""
TIME = np.repeat((0.05, 0.08, 0.08, 0.015, 0.004, 0.003, 0.003), (3, 2, 1, 3, 3, 12, 12))
"""Definitions: (36,) correlation times of the same [s]."""
WHITE = 1.0 / 3.0
"""Definition: standard deviation of white noise beside the coloured one, as a share of it."""
ACCELEROMETER, ACCELEROMETER_TIME = 0.1, 0.01
"""Definitions: standard deviation [m/s²] and correlation time [s]."""
INSTRUMENT_TIME = 0.008
"""Definition: correlation time of the laboratory's instruments [s]."""


class Senses:
    """The sensors of one run; see :class:`benchmarks.plants.rollout.Senses`."""

    def __init__(self, machine: Machine, rng: Generator, ticks: int) -> None:
        self._rng, self._noise = rng, machine.noise
        errors = WHITE * rng.normal(size=(ticks, 36))
        for time in np.unique(TIME):
            alike = np.flatnonzero(time == TIME)
            errors[:, alike] += carried(rng.normal(size=(ticks, alike.size)), float(time))
        self._errors = machine.noise * COLOURED * errors
        self._errors[:, 3:5] += (
            radians(machine["attitude_bias.roll"]),
            radians(machine["attitude_bias.pitch"]),
        )
        self._tick = 0

    def read(self, truth: FloatArray, encoders: FloatArray) -> FloatArray:
        seen = np.concatenate((truth[:12], encoders)) + self._errors[self._tick]
        self._tick += 1
        return seen

    def accelerometer(self, ticks: int) -> FloatArray:
        white = self._rng.normal(size=(ticks, 3))
        return self._noise * ACCELEROMETER * carried(white, ACCELEROMETER_TIME)

    def instrument(self, ticks: int, width: int, deviation: float) -> FloatArray:
        return deviation * carried(self._rng.normal(size=(ticks, width)), INSTRUMENT_TIME)
