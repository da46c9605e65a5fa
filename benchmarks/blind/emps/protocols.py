"""The axis's excitation protocols on a machine of this generator, from the words of the protocols alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import log, pi

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.emps.axis import GTAU, run
from benchmarks.blind.emps.machine import CENTRE, TICK, Machine, drawn_nuisance
from s2r_spec.backend import Parameter
from s2r_spec.protocols import PROTOCOL, Protocol, named
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SHARE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "share of the full amplitude")
STIFF = Parameter("gain", "", 0.5, 1.5, 1.0, "factor on the controller's stiffness")
LOAD = Parameter("payload", "kg", 5.0, 60.0, 30.0, "known mass on the carriage")
LENGTHS = {"coast_down": 1.0, "chirp": 6.0, "steps": 1.6, "loaded": 6.0}
"""Protocol → its duration [s]."""
RUNS = tuple(
    Protocol(
        name, f"the axis's {name}", "ground", length, 0.5, "", (SHARE, STIFF, *([LOAD] * (name == "loaded")))
    )
    for name, length in LENGTHS.items()
)
UNITS = {"q_ref": "m", "q": "m", "v": "m/s", "u": "V", "force": "N"}


def reference(name: str, amplitude: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the reference position [m] in every tick, and whether the drive is on."""
    clock = TICK * np.arange(round(LENGTHS[name] / TICK) + 1)
    on = clock < 9.0
    if name == "coast_down":
        rising = (clock - 0.1) / 0.1
        halfway = 0.1 * (0.5 * rising - np.sin(pi * rising) / (2.0 * pi))
        way = np.select([rising < 0.0, rising < 1.0], [0.0 * clock, halfway], 0.05 + 0.1 * (rising - 1.0))
        return 0.03 + 0.2 * amplitude * way, clock < 0.3 - 1e-6
    if name == "steps":
        begins = 0.1 + 0.25 * np.arange(6) - 1e-6
        jumps = 1e-3 * np.array([0.1, -0.1, 0.3, -0.3, 1.0, -1.0])
        return CENTRE + amplitude * (jumps * (clock[:, None] >= begins)).sum(axis=1), on
    f = np.geomspace(0.5, 50.0, clock.size)
    turned = 2.0 * pi * 6.0 / log(100.0) * (f - f[0])
    grow = np.where(clock < 0.5, 12.0 * clock**2 - 16.0 * clock**3, 1.0)
    return CENTRE + amplitude * grow * 0.03 * 1.1**2 / (1.1**2 + f * f) * np.sin(turned), on


@dataclass(frozen=True)
class Lab:
    """One machine under the protocols; a run is a pure function of the protocol, its parameters and the seed."""

    machine: Machine = field(default_factory=Machine)

    def protocols(self) -> tuple[Protocol, ...]:
        return RUNS

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        values = named(RUNS, protocol, "axis").values(params)
        position, on = reference(protocol, values["amplitude"])
        logs = run(
            [self.machine],
            [values.get("payload", 0.0)],
            position[None],
            on[None],
            [drawn_nuisance(np.random.default_rng(seed))],
            values["gain"],
        )
        q, v, u = (logs[name][0] for name in ("q", "v", "u"))
        channels = {"q_ref": position, "q": q, "v": v, "u": u, "force": GTAU * u}
        return Trace(TICK * np.arange(position.size), channels, UNITS, {PROTOCOL: protocol})
