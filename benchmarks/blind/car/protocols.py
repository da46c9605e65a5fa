"""The car's excitation protocols on the real one, from the words of the protocols alone."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.car.machine import TICK, N, conduct, drawn_nuisance
from benchmarks.blind.outsiders.lab import declared
from s2r_spec.backend import Parameter
from s2r_spec.trace import Trace

Array = NDArray[np.float64]

SHARE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "share of the full amplitude")
STIFF = Parameter("gain", "", 0.5, 1.5, 1.0, "factor on the stiffness of lane keeping")
FAST = Parameter("speed", "m/s", 12.0, 25.0, 22.0, "at the begin")
PROTOCOLS = tuple(
    declared(name, "space", 6.0, FAST if name == "coast_down" else SHARE, STIFF)
    for name in ("steer_chirp", "steer_reversal", "coast_down", "force_steps")
)


def drill(name: str, values: Mapping[str, float], params: Mapping[str, float], rng: Generator) -> Trace:
    """Run a protocol on a car with these effects."""
    sizes = {key: value for key, value in params.items() if key != "gain"}
    return conduct(reference(name, **sizes), values, drawn_nuisance(rng), params["gain"])


def reference(name: str, amplitude: float = 1.0, speed: float = 22.0) -> Array:
    """Return (samples, 7): y and two derivatives, speed, steering added, whether the force is given, the force."""
    clock = np.linspace(0.0, TICK * (N - 1), N)
    rows = np.zeros((7, N))
    begun = clock > 0.5 - 0.25 * TICK
    late = np.where(begun, clock - 0.5, 0.0)
    if name == "coast_down":
        rows[3], rows[5] = speed, begun
    elif name == "force_steps":
        rows[3], rows[5] = 15.0, begun
        for begin, change in ((25, 3000.0), (100, -6000.0), (175, 4500.0), (250, -3000.0)):
            rows[6, begin:] += amplitude * change
    elif name == "steer_reversal":
        corners = [0.5, *(0.75 + 0.5 * np.arange(12))]
        rows[3] = 18.0
        rows[4] = 0.04 * amplitude * np.interp(clock, corners, [0.0, *(1.0, -1.0) * 6])
    else:
        grow = np.where(late < 0.5, late * late * (12.0 - 16.0 * late), 1.0)
        middle = 0.3 + (6.0 - 0.3) * late / 5.5 / 2.0
        rows[3] = 18.0
        rows[4] = 0.04 * amplitude * grow * np.sin(2.0 * pi * middle * late)
    return np.ascontiguousarray(rows.T)
