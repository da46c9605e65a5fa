"""A machine of someone outside under its excitation protocols: a laboratory that runs them on one machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol as Shape

import numpy as np
from numpy.random import Generator

from s2r_spec.backend import Parameter
from s2r_spec.protocols import PROTOCOL, Place, Protocol, named
from s2r_spec.trace import Trace


def declared(name: str, place: Place, duration: float, *parameters: Parameter) -> Protocol:
    """Return a protocol as a laboratory declares it: the words are those of the simulator's protocol."""
    return Protocol(name, f"as the simulator's {name}", place, duration, 0.01, "", parameters)


class Drilled(Shape):
    """What a module of protocols must have: its protocols, and how a machine with these effects runs one of them."""

    PROTOCOLS: tuple[Protocol, ...]
    drill: Callable[[str, Mapping[str, float], Mapping[str, float], Generator], Trace]


@dataclass(frozen=True)
class Lab:
    """One machine; a run is a pure function of the protocol, its parameters and the seed.

    Attributes:
        module: the machine's protocols.
        values: effects of the machine, known and unknown, by name.
    """

    module: Drilled
    values: Mapping[str, float] = field(default_factory=dict)

    def protocols(self) -> tuple[Protocol, ...]:
        return self.module.PROTOCOLS

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        values = named(self.module.PROTOCOLS, protocol, "lab").values(params)
        trace = self.module.drill(protocol, self.values, values, np.random.default_rng(seed))
        return Trace(trace.times, trace.channels, trace.units, {**trace.meta, PROTOCOL: protocol})
