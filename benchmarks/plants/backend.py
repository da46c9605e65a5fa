"""A plant as a backend, for a diagnosis that chooses rollouts and protocols itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np

from benchmarks.plants import Plant
from benchmarks.plants.robot import CHANNELS, EXCITATION
from s2r_spec.backend import Channel, Parameter, read_test
from s2r_spec.protocols import Protocol, named
from s2r_spec.trace import Trace

VELOCITY = Parameter("vd", "m/s", -0.5, 0.5, 0.0, "forward velocity commanded at t = 0")


@dataclass(frozen=True)
class PlantBackend:
    """One machine. A run is a pure function of its parameters and its seed."""

    plant: Plant
    duration: float = 1.5
    cost: float = 1.0
    channels: tuple[Channel, ...] = field(default=CHANNELS, init=False, repr=False)
    parameters: tuple[Parameter, ...] = field(default=(VELOCITY,), init=False, repr=False)
    deterministic: bool = field(default=True, init=False)

    @property
    def name(self) -> str:
        """Name of the plant. The machine's effects are not in it."""
        return f"{self.plant.author.name} plant"

    @property
    def model_hash(self) -> str:
        """Hex digest over the machine and this package's source."""
        source = [path.read_bytes() for path in sorted(Path(__file__).parent.rglob("*.py"))]
        return sha256(b"".join([repr(self.plant.machine).encode(), *source])).hexdigest()

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test."""
        test = read_test(self.name, self.parameters, params)
        return self.plant.trot(test["vd"], np.random.default_rng([1, seed]), self.duration)

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the excitation protocols of the A1."""
        return EXCITATION

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol."""
        values = named(EXCITATION, protocol, self.name).values(params)
        return self.plant.run(protocol, np.random.default_rng([2, seed]), **values)
