"""Random variation between rollouts; every number is drawn from the rollout's seed."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import NDArray

from s2r_emps.physics import STEP
from s2r_spec.compiled import compiled

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Standard deviations of normal distributions."""

    encoder: float = 1.7e-7
    """White noise of the encoder [m]; second differences of the real axis's recorded position are 0.41 µm."""
    disturbance: float = 1.0
    """Force on the carriage [N]; about half of the force residual of the documented model on the real axis."""
    disturbance_time: float = 0.1
    """Correlation time of that force [s]."""
    gain: float = 0.002
    """Force per volt, as a share of it: the motor's temperature varies."""
    payload: float = 0.1
    """Mass of the payload [kg]."""
    start: float = 2e-5
    """Position of the carriage at the beginning of a move [m]."""

    @classmethod
    def off(cls) -> Noise:
        """Return the table of a rollout without noise."""
        return cls(encoder=0.0, disturbance=0.0, gain=0.0, payload=0.0, start=0.0)


@dataclass(frozen=True, eq=False)
class Draws:
    """The random numbers of one rollout.

    Attributes:
        gain: factor on the force per volt.
        payload: mass on top of the test's payload [kg].
        start: displacement at the beginning [m].
        encoder: (ticks,) error of the measured position [m].
        disturbance: (ticks,) force on the carriage in the positive direction [N].
        seed: of the rollout.
    """

    gain: float
    payload: float
    start: float
    encoder: FloatArray
    disturbance: FloatArray
    seed: int

    @property
    def delay(self) -> FloatArray:
        """(ticks,) standard normal, from a stream of its own: a jitter leaves all other numbers as they are."""
        stream = np.random.SeedSequence(self.seed, spawn_key=(1,))
        return np.random.default_rng(stream).normal(size=self.encoder.size)


def draw(noise: Noise, seed: int, ticks: int) -> Draws:
    """Draw a rollout's random numbers; a longer rollout starts with those of a shorter one."""
    rng = np.random.default_rng(seed)
    gain, payload, start = rng.normal(size=3).tolist()
    white = rng.normal(size=(ticks, 2))
    return Draws(
        gain=1.0 + noise.gain * gain,
        payload=noise.payload * payload,
        start=noise.start * start,
        encoder=noise.encoder * white[:, 0],
        disturbance=noise.disturbance * _colour(white[:, 1], noise.disturbance_time),
        seed=seed,
    )


def _colour(white: FloatArray, time: float) -> FloatArray:
    """Return (n,) samples of an Ornstein-Uhlenbeck process with unit variance and correlation time ``time`` [s]."""
    keep = exp(-STEP / time)
    return _autoregressive(np.ascontiguousarray(white), keep, (1.0 - keep * keep) ** 0.5)


@compiled
def _autoregressive(white: FloatArray, keep: float, fresh: float) -> FloatArray:
    values = np.empty_like(white)
    state = values[0] = white[0]
    for k in range(1, white.size):
        state = keep * state + fresh * white[k]
        values[k] = state
    return values
