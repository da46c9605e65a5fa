"""Excitation protocols: motions that a backend runs to identify itself, beside the tests of a specification.

A protocol has no specification and no ρ. The machine's own low-level controller runs it. Where a test of the
specification hides an effect in its feedback loop, a protocol excites it. `s2r diagnose` uses both.
"""

from __future__ import annotations

import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, runtime_checkable

from s2r_spec.backend import Parameter, read_test
from s2r_spec.errors import UsageError, did_you_mean, one_of
from s2r_spec.trace import Trace

Place = Literal["air", "ground", "space"]
"""What a protocol needs around the machine: held in the air, standing on the ground, or free space to move in."""

PROTOCOL = "protocol"
"""Definition: the key of a trace's ``meta`` with the name of its protocol. A trace of a test has no such key."""


PLAYED = "play"
"""Definition: ``meta["protocol"]`` of a trace of :meth:`HasInputs.play`, whose input came without feedback."""


@dataclass(frozen=True)
class Protocol:
    """A motion for identification.

    Attributes:
        name: its name, such as "air_sine".
        words: what a person does and what the machine then does, in one or two sentences.
        place: what it needs around the machine.
        duration: duration of its trace [s].
        cost: expected time of one run on one core [s]; of a machine, the time of the run and its preparation.
        risk: what can go wrong, in words; "" if nothing more than in a test.
        parameters: its parameters, with ranges and defaults.
    """

    name: str
    words: str
    place: Place
    duration: float
    cost: float
    risk: str = ""
    parameters: tuple[Parameter, ...] = ()

    def values(self, params: Mapping[str, float]) -> dict[str, float]:
        """Return the value of every parameter; a missing one takes its default.

        Raises:
            UsageError: a parameter is not declared, is not a number, or is outside its range.
        """
        return read_test(self.name, self.parameters, params)


@runtime_checkable
class HasInputs(typing.Protocol):
    """A backend that can play a recorded input instead of its controller's, which excites one without protocols."""

    def play(self, inputs: Trace, params: Mapping[str, float], seed: int) -> Trace:
        """Play a recorded input without feedback; ``meta["protocol"]`` of the trace is "play".

        Args:
            inputs: trace with the channels of the controller's output; other channels may say where the motion begins.
            params: parameters of the test in which the machine stands; a missing one takes its default.
            seed: seed of the run's random numbers.

        Returns:
            The channels of a rollout over the times of ``inputs``. A fall or a crash ends it and sets
            ``meta["failure"]``.

        Raises:
            TraceError: a channel of the input is missing, or its samples are not those of the controller.
            UsageError: a parameter is unknown or out of range.
        """
        ...


@runtime_checkable
class HasProtocols(typing.Protocol):
    """A backend that can run protocols."""

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the protocols that this backend can run."""
        ...

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol; ``meta["protocol"]`` of the trace is its name.

        A fall or a crash sets ``meta["failure"]`` and raises nothing.

        Raises:
            UsageError: the backend has no such protocol, or a parameter is unknown or out of range.
        """
        ...


def named(protocols: Iterable[Protocol], name: str, backend: str) -> Protocol:
    """Return a protocol by its name.

    Raises:
        UsageError: the backend does not have it.
    """
    found = {one.name: one for one in protocols}
    if name not in found:
        raise UsageError(
            f"the backend {backend!r} has no protocol {name!r}{did_you_mean(name, found)}; it has {one_of(found)}"
        )
    return found[name]
