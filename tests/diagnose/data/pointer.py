"""A cheap machine with one test parameter and two protocols, in units that a test chooses."""

from dataclasses import dataclass, field, replace

import numpy as np

import s2r_spec as s2r
from s2r_spec.backend import Channel, Parameter
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.errors import UsageError
from s2r_spec.protocols import Protocol, named
from s2r_spec.runs.compatibility import check_compatibility
from s2r_spec.trace import Trace

SPEC = s2r.parse_spec("""
param  vd {m/s} in [0.2, 1]
signal v {m/s}
require fast: always[0.5, 0.9 s] (v >= 0.1 {m/s})
certify fast: delta = 0.1, epsilon = 0.05, B = 1, R = 0.05, kernel = rbf(0.5), fall = -1
""")
TIMES = np.arange(101) / 100
AMPLITUDE = Parameter("amplitude", "", 0.1, 1.0, 1.0, "share of the full swing")
PROTOCOLS = (
    Protocol("chirp", "It swings faster and faster.", "space", 1.0, 0.01, parameters=(AMPLITUDE,)),
    Protocol("coast", "The motor is off.", "space", 1.0, 0.01, "it hits the end", (AMPLITUDE,)),
)


@dataclass(frozen=True)
class Pointer:
    """It tends to its speed; with ``unit`` "cm/s", speeds are so in its channel and parameter."""

    unit: str = "m/s"
    offered: tuple = PROTOCOLS
    refuses: str = ""
    falls: str = ""
    ran: list = field(default_factory=list, compare=False)
    name: str = "pointer"
    deterministic: bool = True
    cost: float = 1e-4
    duration: float = 1.0
    model_hash: str = "1"

    @property
    def scale(self):
        return 100.0 if self.unit == "cm/s" else 1.0

    @property
    def channels(self):
        return (Channel("v", self.unit, "speed"),)

    @property
    def parameters(self):
        return (Parameter("vd", self.unit, 0.0, 2.0 * self.scale, 0.5 * self.scale, "wanted speed"),)

    def protocols(self):
        return self.offered

    def rollout(self, params, seed):
        return self._trace(params["vd"] * (1 - np.exp(-5 * TIMES)), seed)

    def run(self, protocol, params, seed):
        values = named(self.offered, protocol, self.name).values(params)
        if protocol == self.refuses:
            raise UsageError("the track is too short")
        swing = values["amplitude"] * self.scale * np.sin((6 if protocol == "chirp" else 2) * TIMES)
        trace = self._trace(swing, seed, {"protocol": protocol})
        if protocol == self.falls:
            trace = Trace(
                TIMES[:40], {"v": trace["v"][:40]}, trace.units, dict(trace.meta) | {"failure": "fall"}
            )
        return trace

    def _trace(self, v, seed, meta=None):
        self.ran.append(seed)
        noise = 0.01 * self.scale * np.random.default_rng(seed).normal(size=TIMES.size)
        return Trace(TIMES, {"v": v + noise}, {"v": self.unit}, meta or {})


def bench_of(backend=None, spec=SPEC):
    backend = backend or Pointer()
    return Bench(backend, spec, "fast", check_compatibility(spec, "fast", backend))


def limited(machine, high):
    """Return the machine with another range of its protocols' amplitude."""
    short = replace(AMPLITUDE, high=high, default=high)
    return replace(machine, offered=tuple(replace(p, parameters=(short,)) for p in machine.offered))
