"""The balancing robot's excitation protocols on the real one, from the words of the protocols alone."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.outsiders.lab import declared
from benchmarks.blind.segway.machine import TS, conduct, drawn_nuisance
from s2r_spec.backend import Parameter
from s2r_spec.trace import Trace

Array = NDArray[np.float64]

SHARE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "share of the full amplitude")
LOAD = Parameter("cargo", "kg", 0.0, 3.0, 1.0, "declared load")
LENGTHS = {"chirp": 6.0, "torque_steps": 7.0, "held_steps": 4.0, "held_coast": 5.0}
PROTOCOLS = tuple(declared(name, "ground", length, SHARE, LOAD) for name, length in LENGTHS.items())


def drill(name: str, values: Mapping[str, float], params: Mapping[str, float], rng: Generator) -> Trace:
    """Run a protocol on a robot with these effects."""
    rows = reference(name, params["amplitude"])
    rolls = params["amplitude"] if name == "held_coast" else 0.0
    nuisance = drawn_nuisance(rng, len(rows))
    return conduct(rows, params["cargo"], values, nuisance, held=name.startswith("held"), rolls=rolls)


def reference(name: str, amplitude: float) -> Array:
    """Return (samples, 4): reference acceleration, speed and place, and a torque beside the controller's."""
    n = round(LENGTHS[name] / TS) + 1
    clock, nothing = np.linspace(0.0, LENGTHS[name], n), np.zeros(n)
    if name == "chirp":
        grow = np.where(clock < 1.0, 3.0 * clock**2 - 2.0 * clock**3, 1.0)
        mean = 0.3 + (4.0 - 0.3) * clock / 6.0 / 2.0
        a = 0.8 * amplitude * grow * np.cos(2.0 * pi * mean * clock)
        v = np.add.accumulate(a * TS)
        return np.stack([a, v, np.add.accumulate(v * TS), nothing], axis=1)
    torque = nothing.copy()
    if name == "torque_steps":
        for begin, size in ((100, 0.5), (250, 1.0), (400, 2.0), (550, 3.0)):
            torque[begin : begin + 10] += amplitude * size
            torque[begin + 10 : begin + 20] -= amplitude * size
    elif name == "held_steps":
        for step, size in enumerate((0.2, 0.5, 1.5, 4.0)):
            torque[40 + 80 * step : 80 + 80 * step] = amplitude * size
            torque[80 + 80 * step : 120 + 80 * step] = -amplitude * size
    return np.stack([nothing, nothing, nothing, torque], axis=1)
