"""The arm's excitation protocols on the real one, from the words of the protocols alone."""

from __future__ import annotations

from collections.abc import Mapping
from math import log, pi

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.arm.machine import TS, conduct, drawn_nuisance
from benchmarks.blind.outsiders.lab import declared
from s2r_spec.backend import Parameter
from s2r_spec.trace import Trace

Array = NDArray[np.float64]

SHARE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "share of the full amplitude")
STIFF = Parameter("gain", "", 0.5, 1.5, 1.0, "factor on the joints' stiffness")
LOAD = Parameter("payload", "kg", 0.0, 2.5, 1.5, "known mass at the flange")
LENGTHS = {"shoulder_chirp": 5.0, "elbow_chirp": 5.0, "steps": 3.3, "sweep": 6.0, "coast": 4.0}
PROTOCOLS = tuple(declared(name, "space", length, SHARE, STIFF, LOAD) for name, length in LENGTHS.items())


def drill(name: str, values: Mapping[str, float], params: Mapping[str, float], rng: Generator) -> Trace:
    """Run a protocol on an arm with these effects."""
    ref, on = reference(name, params["amplitude"])
    return conduct(ref, on, params["payload"], values, drawn_nuisance(rng, len(ref)), params["gain"])


def reference(name: str, amplitude: float) -> tuple[Array, Array]:
    """Return (samples, 6): two reference angles, speeds and accelerations; and (samples,) whether the drives are on."""
    n = round(LENGTHS[name] / TS) + 1
    ticks, on = np.arange(n), np.ones(n)
    ref = np.zeros((n, 6))
    ref[:, 0], ref[:, 1] = -0.6, 0.8
    if name == "steps":
        for joint, begin, size in ((0, 150, 0.1), (1, 650, 0.1), (0, 1150, 0.25), (1, 1150, 0.25)):
            ref[begin : begin + 250, joint] += amplitude * size
        return ref, on
    if name == "coast":
        on[250:] = 0.0
        ref[:, :2] = -pi / 2, 0.0
        ref[:250, :2] += amplitude * np.array([0.3, 0.2])
        return ref, on
    clock = TS * ticks
    if name == "sweep":
        path = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
        there = np.interp(clock, [0.25, 2.75, 3.25, 5.75], [0.0, 1.0, 1.0, 0.0])
        there = np.where(clock < 3.0, path(there), 1.0 - path(1.0 - there))
        begin, end = np.array([-1.4, 1.2]), np.array([0.4, -0.4])
        ref[:, :2] = (begin + end) / 2 + amplitude * (end - begin) * (there[:, None] - 0.5)
    else:
        f = np.geomspace(0.5, 12.0, n)
        grow = np.where(clock < 0.5, 12.0 * clock**2 - 16.0 * clock**3, 1.0)
        wave = grow * np.sin(2.0 * pi * 5.0 / log(24.0) * (f - f[0])) * 2.25 / (2.25 + f * f)
        joint, size = (0, 0.25) if name == "shoulder_chirp" else (1, 0.3)
        ref[:, joint] += amplitude * size * wave
    for order in (2, 4):  # of central differences, and one-sided ones at the ends
        before = ref[:, order - 2 : order]
        ref[1:-1, order : order + 2] = (before[2:] - before[:-2]) / (2 * TS)
        ref[0, order : order + 2] = (before[1] - before[0]) / TS
        ref[-1, order : order + 2] = (before[-1] - before[-2]) / TS
    return ref, on
