"""What a run draws at random: when messages reach the wheels, and how the wheels slip."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter

from benchmarks.blind.turtlebot.plant import SUB, FloatArray, H, IntArray, Numbers

TICKS = 400
"""Definition: periods of the controller in one run."""
SETTLED = 4.0
"""Definition: time after which a growing effect has its full size [s]."""


def messages(rng: Generator, p: Numbers) -> IntArray:
    """Return (2, steps) of the newest message at the wheels, for speed and turning rate; −1 before the first.

    Delays jitter from message to message, and no message overtakes another. Waiting for the one before makes a message
    later. Therefore the delays are scaled until the commands in force are as late, in the mean, as the label says.
    """
    sent = H * SUB * np.arange(TICKS)
    share = np.ones(TICKS)
    if p.jitter:
        uniform = 1.0 + sqrt(3.0) * p.jitter * rng.uniform(-1.0, 1.0, TICKS)
        share = rng.gamma(p.jitter**-2, p.jitter**2, TICKS) if p.gamma else uniform
    dither = rng.random(TICKS)
    both = np.empty((2, SUB * TICKS), dtype=np.int64)
    for row, extra in enumerate((0.0, p.turning_delay)):
        delays = p.latency + extra + p.growing_delay * np.minimum(sent / SETTLED, 1.0)
        factor = 1.0
        for _ in range(4):
            both[row] = _newest(sent + factor * share * delays, p.grain, dither)
            late = _late(both[row])
            factor *= delays.mean() / late if late > 0.0 else 1.0
    return both


def _newest(arrivals: FloatArray, grain: float, dither: FloatArray) -> IntArray:
    # Times are kept in whole steps. The dither keeps the mean delay, which rounding up would raise.
    whole = np.maximum.accumulate(np.floor(arrivals / H / grain + dither + 1e-9) * grain)
    return np.asarray(np.searchsorted(whole, np.arange(SUB * TICKS), side="right") - 1)


def _late(newest: IntArray) -> float:
    """Return the mean time [s] by which the command in force is older than without a delay."""
    steps = np.arange(newest.size)
    there = newest >= 0
    return float(H * np.mean(steps[there] // SUB - newest[there]) * SUB) if there.any() else 0.0


def coloured(rng: Generator, p: Numbers) -> FloatArray:
    """Return (2, steps) of errors of speed (relative) and turning rate [rad/s], white only below the colour's corner.

    Averaged over one second they have the simulator's standard deviation, ``slip_noise``.
    """
    keep = np.exp(-H / p.colour)
    white = rng.normal(size=(2, SUB * TICKS)) * p.slip_noise / sqrt(2.0 * p.colour)
    return np.asarray(lfilter([sqrt(1.0 - keep * keep)], [1.0, -keep], white, axis=1))
