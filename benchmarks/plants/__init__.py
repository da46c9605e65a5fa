"""Two A1s by other authors: other contact, integrator, drives and noise than the simulator and the blind generator.

A diagnosis of a machine with nothing wrong should name nothing, whoever wrote the machine's laws. These plants test
that. With one large effect, it should name that effect. Both run the trot of ``specs/a1_velocity.stl`` and the A1's
excitation protocols. They share the robot's controller, logger and figures with the simulator (``robot.py``), and
nothing else.

    smooth   Kelvin–Voigt feet, tanh friction, a current loop, 16-bit encoders, a filtered gyro, 0.5 ms semi-implicit
    stiff    nearly rigid feet, Coulomb friction with a rise at rest, sampled drives, coloured noise, 1 ms Runge–Kutta

Everything here is a twin. Nothing was measured on a robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from numpy.random import Generator

from benchmarks.plants import rollout
from benchmarks.plants.machine import Machine
from benchmarks.plants.rollout import Author
from benchmarks.plants.smooth import SMOOTH
from benchmarks.plants.stiff import STIFF
from s2r_spec.trace import Trace

PLANTS: Mapping[str, Author] = {author.name: author for author in (SMOOTH, STIFF)}


@dataclass(frozen=True)
class Plant:
    """A machine by one author. A run is a pure function of its arguments."""

    author: Author
    machine: Machine

    def trot(self, vd: float, rng: Generator, duration: float = 1.5) -> Trace:
        """Run the specification's test at a commanded velocity [m/s]."""
        return rollout.trot(self.author, self.machine, vd, rng, duration)

    def run(self, protocol: str, rng: Generator, amplitude: float = 1.0, gain: float = 1.0) -> Trace:
        """Run an excitation protocol of the A1."""
        return rollout.run(self.author, self.machine, protocol, rng, amplitude, gain)
