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
    for name, length in (("pitch_chirp", 5.0), ("heave_chirp", 5.0), ("rotor_steps", 5.0), ("coast", 3.0))
)


def drill(name: str, values: Mapping[str, float], params: Mapping[str, float], rng: Generator) -> Trace:
    """Run a protocol on a machine with these effects."""
    ticks = len(asked(name, 1.0))
    return conduct(
        asked(name, params["amplitude"]), values, drawn_nuisance(rng, ticks), 0.0, params["gain"], every=1
    )


def asked(name: str, amplitude: float) -> Array:
    """Return (ticks, 9): x, its speed and acceleration, z, its two, whether level, thrusts added front and rear."""
    length = {protocol.name: protocol.duration for protocol in PROTOCOLS}[name]
    clock = np.linspace(0.0, length, round(length / TC) + 1)
    nothing, one = np.zeros_like(clock), np.ones_like(clock)
    x, vx, ax, level, front, rear = nothing, nothing, nothing, nothing, nothing, nothing
    if name == "rotor_steps":
        pair = 1.5 * amplitude * np.concatenate([np.ones(20), -np.ones(20)])
        front, rear = nothing.copy(), nothing.copy()
        for rotor, begin in ((front, 200), (rear, 400), (front, 600), (rear, 800)):
            rotor[begin : begin + 40] = pair
    elif name == "coast":
        part = np.interp(clock, [0.5, 1.5], [0.0, 1.0])
        rise, slope = (np.polynomial.Polynomial([0, 0, 0, 10, -15, 6]).integ(m) for m in (1, 0))
        x = 1.5 * amplitude * (rise(part) + np.where(clock > 1.5, clock - 1.5, 0.0))
        vx, ax = 1.5 * amplitude * slope(part), 1.5 * amplitude * slope.deriv()(part)
        level = (np.arange(clock.size) >= 300).astype(float)
    else:
        low, high = (2.0, 25.0) if name == "pitch_chirp" else (1.0, 10.0)
        late = np.where(clock > 1.0, clock - 1.0, 0.0)
        mean = low + (high - low) / 4.0 * late / 2.0
        grow = np.where(late < 0.5, 12.0 * late**2 - 16.0 * late**3, 1.0)
        rear = amplitude * grow * np.sin(2.0 * pi * mean * late)
        front = -rear if name == "pitch_chirp" else rear
    height = 0.5 if name == "heave_chirp" else 1.0
    return np.stack([x, vx, ax, height * one, nothing, nothing, level, front, rear], axis=1)
