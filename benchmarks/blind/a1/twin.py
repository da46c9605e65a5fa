"""One particular robot in one particular place, and what its every run adds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.random import Generator

from benchmarks.blind.a1.model import Build
from benchmarks.blind.a1.nominal import nominal
from benchmarks.blind.a1.sensing import Sensing
from benchmarks.blind.a1.world import Record


@dataclass(frozen=True)
class Timing:
    """When commands reach the drives.

    Attributes:
        delay: mean [s] of a delay that differs from command to command.
        lost_every, lost_for: [s] period and length of gaps in which no command arrives.
        lost_from: [s] of the first gap after the command's step.
        stale: [s] by which the controller's picture of the robot is old at most, differing from tick to tick.
    """

    delay: float = 0.0
    lost_every: float = 0.0
    lost_for: float = 0.0
    lost_from: float = 0.0
    stale: float = 0.0

    def lost(self, elapsed: float) -> bool:
        """Return whether a command sent at this time [s] is lost."""
        if self.lost_for == 0.0 or elapsed < self.lost_from:
            return False
        return (elapsed - self.lost_from) % self.lost_every < self.lost_for


@dataclass
class Twin:
    """All that decides what the real rollouts of a case are like, apart from their seeds.

    Effects change it in place while a case is made; afterwards it stays as it is.
    """

    build: Build = field(default_factory=Build)
    world: Record = field(default_factory=nominal)
    sensing: Sensing = field(default_factory=Sensing)
    timing: Timing = field(default_factory=Timing)


def of_today(twin: Twin, rng: Generator) -> Twin:
    """Return the same twin as it is in one run: warm or cold, on another spot, with another battery."""
    world = twin.world.copy()
    warm = rng.normal()
    world["coulomb"] *= 1.0 - 0.05 * warm
    world["viscous"] *= 1.0 - 0.08 * warm
    world["strength"] *= 1.0 - 0.004 * abs(rng.normal())
    world["mu"] *= 1.0 + 0.03 * rng.normal()
    world["drag"] *= 1.0 + 0.05 * rng.normal()
    roll, pitch = twin.sensing.attitude_bias
    forward, left = twin.sensing.velocity_bias
    a, b = (0.03 * rng.normal(size=2)).tolist()
    c, d = (0.0015 * rng.normal(size=2)).tolist()
    sensing = replace(
        twin.sensing, attitude_bias=(roll + a, pitch + b), velocity_bias=(forward + c, left + d)
    )
    return replace(twin, world=world, sensing=sensing)


def uneven(rng: Generator, shape: tuple[int, int], cell: float) -> Record:
    """Return a patch of smooth random ground of deviation 1: noise, kept at wavelengths around 0.33 m."""
    white = np.fft.rfft2(rng.normal(size=shape))
    along, across = np.fft.fftfreq(shape[0], cell)[:, None], np.fft.rfftfreq(shape[1], cell)
    cycles = np.hypot(along, across)
    kept = np.exp(-0.5 * (np.log(np.maximum(cycles, 1e-6) * 0.33) / 0.3) ** 2)
    ground = np.fft.irfft2(white * kept, shape)
    return ground / ground.std()
