"""The quadrotor's excitation protocols on the real one, from the words of the protocols alone."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.outsiders.lab import declared
from benchmarks.blind.quad.machine import TC, conduct, drawn_nuisance
from s2r_spec.backend import Parameter
from s2r_spec.trace import Trace

Array = NDArray[np.float64]

SHARE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "share of the full amplitude")
STIFF = Parameter("gain", "", 0.5, 1.5, 1.0, "factor on the stiffness of the pitch loop")
PROTOCOLS = tuple(
    declared(name, "space", length, SHARE, STIFF)
    for name, length in (("pitch_chirp", 5.0), ("heave_chirp", 6.0), ("rotor_steps", 5.0), ("coast", 3.0))
)


def drill(name: str, values: Mapping[str, float], params: Mapping[str, float], rng: Generator) -> Trace:
    """Run a protocol on a machine with these effects."""
    ticks = len(reference(name, 1.0))
    return conduct(
        reference(name, params["amplitude"]), values, drawn_nuisance(rng, ticks), 0.0, params["gain"], every=1
    )


def reference(name: str, amplitude: float) -> Array:
    """Return (ticks, 9): x, its speed and acceleration, z, its two, whether level, thrusts added front and rear."""
    length = {protocol.name: protocol.duration for protocol in PROTOCOLS}[name]
    clock = np.linspace(0.0, length, round(length / TC) + 1)
    x, vx, ax, level, front, rear = (np.zeros_like(clock) for _ in range(6))
    z, vz, az = np.ones_like(clock), np.zeros_like(clock), np.zeros_like(clock)
    step = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    part = np.interp(clock, [0.5, 2.0], [0.0, 1.0])
    if name == "rotor_steps":
        pair = 3.0 * amplitude * np.concatenate([np.ones(20), -np.ones(20)])
        for begin in range(200, 1000, 200):
            front[begin : begin + 40] = rear[begin + 100 : begin + 140] = pair
    elif name == "coast":
        fast = 3.0 * amplitude
        x = fast * (1.5 * step.integ()(part) + np.where(clock > 2.0, clock - 2.0, 0.0))
        vx, ax = fast * step(part), fast * step.deriv()(part) / 1.5
        level = (np.arange(clock.size) >= 400).astype(float)
    else:
        begin, low, high = (1.0, 2.0, 25.0) if name == "pitch_chirp" else (2.0, 1.0, 10.0)
        late = np.where(clock > begin, clock - begin, 0.0)
        mean = low + (high - low) / 4.0 * late / 2.0
        grow = np.where(late < 0.5, 12.0 * late**2 - 16.0 * late**3, 1.0)
        rear = amplitude * grow * np.sin(2.0 * pi * mean * late)
        front = -rear
        if name == "heave_chirp":
            front = rear
            z, vz = 1.0 - 0.65 * step(part), -0.65 * step.deriv()(part) / 1.5
            az = -0.65 * step.deriv(2)(part) / 1.5**2
    return np.stack([x, vx, ax, z, vz, az, level, front, rear], axis=1)
