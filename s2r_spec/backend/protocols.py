"""Excitation protocols: motions that a backend runs to identify itself, beside the tests of a specification.

A protocol has no specification and no ρ. The machine's own low-level controller runs it. Where a test of the
specification hides an effect in its feedback loop, a protocol excites it. `s2r diagnose` uses both.
"""

from __future__ import annotations

import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, runtime_checkable

import numpy as np

from s2r_spec import logs
from s2r_spec.backend import Parameter, read_test
from s2r_spec.base.errors import BackendError, UsageError, did_you_mean, one_of
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


@runtime_checkable
class HasProtocols(typing.Protocol):
    """A backend that can run protocols."""

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the protocols that this backend can run."""

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol; ``meta["protocol"]`` of the trace is its name.

        A fall or a crash sets ``meta["failure"]`` and raises nothing.

        Raises:
            UsageError: the backend has no such protocol, or a parameter is unknown or out of range.
        """


@runtime_checkable
class HasPlayable(typing.Protocol):
    """A backend that gives a protocol as references for a machine's own joint controller."""

    def playable(self, protocol: str, params: Mapping[str, float]) -> Trace:
        """Return the references at the machine's rate.

        Returns:
            Channels ``q`` and ``dq`` (n, joints), and ``kp`` and ``kd``, (n,) or of each joint, with units. Every joint
            follows τ = kp (q − q_measured) + kd (dq − dq_measured).

        Raises:
            UsageError: the backend has no such protocol, or a parameter is unknown or out of range.
        """


@runtime_checkable
class AttendsProtocols(typing.Protocol):
    """A machine's attendance that prepares protocols, too; see :class:`s2r_spec.backend.Attended`."""

    def before_protocol(self, protocol: Protocol, params: Mapping[str, float]) -> None:
        """Return when the run of a protocol may begin; before its first use, ask about its risk.

        Raises:
            NotBegunError: the run may not begin; the operator decides whether to try again.
            StoppedError: the operator ends the run.
        """


def named(protocols: Iterable[Protocol], name: str, backend: str) -> Protocol:
    """Return a protocol by its name.

    Raises:
        UsageError: the backend does not have it.
    """
    by_name = {one.name: one for one in protocols}
    if name not in by_name:
        raise UsageError(
            f"the backend {backend!r} has no protocol {name!r}{did_you_mean(name, by_name)}; it has {one_of(by_name)}"
        )
    return by_name[name]


def protocol_of(backend: object, name: str) -> Protocol:
    """Return a protocol of a backend by its name.

    Raises:
        UsageError: the backend offers no protocols, or not this one.
    """
    called = str(getattr(backend, "name", type(backend).__name__))
    if not isinstance(backend, HasProtocols):
        raise UsageError(f"the backend {called!r} offers no protocols; it can run tests of a spec only")
    return named(backend.protocols(), name, called)


def run_protocol(backend: object, name: str, params: Mapping[str, float], seed: int) -> Trace:
    """Run a protocol of a backend, and return its trace.

    Raises:
        UsageError: the backend offers no protocols, or not this one; or a parameter is wrong.
        BackendError: the result is not a trace with this protocol's name in its ``meta``.
    """
    protocol_of(backend, name)
    assert isinstance(backend, HasProtocols)
    trace: object = backend.run(name, params, seed)
    if not isinstance(trace, Trace):
        raise BackendError(f"the protocol {name!r} returned a {type(trace).__name__} instead of a Trace")
    if trace.meta.get(PROTOCOL) != name:
        raise BackendError(
            f"the trace of the protocol {name!r} has meta[{PROTOCOL!r}] = {trace.meta.get(PROTOCOL)!r}; "
            f"it must be the name of the protocol"
        )
    return trace


def write_playable(backend: object, protocol: str, params: Mapping[str, float], path: str | Path) -> str:
    """Write a protocol's references as a CSV file that a robot can play; return what a person does with it.

    The file has one header line with units, and a row at every tick: ``t``, ``q_0`` …, ``dq_0`` …, ``kp``, ``kd``.

    Args:
        backend: a backend with :class:`HasProtocols` and :class:`HasPlayable`.
        protocol: name of the protocol.
        params: its parameters; a missing one takes its default.
        path: path of the file, with the ending ``.csv``; an existing file is replaced.

    Raises:
        UsageError: the backend has no such protocol or no references of it, a parameter is wrong, or the path does not
            end in ``.csv``.
        TraceError: the file cannot be written.
    """
    one = protocol_of(backend, protocol)
    values = one.values(params)
    if not isinstance(backend, HasPlayable):
        raise UsageError(
            f"the backend {getattr(backend, 'name', backend)!r} has no references of its protocols; it needs a method "
            f"playable(protocol, params)"
        )
    if Path(path).suffix.lower() != ".csv":
        raise UsageError(f"{path}: the file of a protocol must end in .csv")
    played = backend.playable(protocol, values)
    logs.write(_flat(played), path)
    return instructions(one, played, path)


def instructions(protocol: Protocol, played: Trace, path: str | Path) -> str:
    """Return what a person does to play a file of references by hand."""
    step = 1e3 * float(np.median(np.diff(played.times)))
    risk = f" Risk: {protocol.risk}." if protocol.risk else ""
    return (
        f"{protocol.words} Move the joints slowly to the angles in the first row of {path}, and hold them until the "
        f"machine is still. Then send a row every {step:g} ms; the torque of a joint is kp (q − measured q) "
        f"+ kd (dq − measured dq). Record from the first row to the last.{risk}"
    )


def _flat(trace: Trace) -> Trace:
    """Return the trace with a channel for each column, ``q_0``, ``q_1`` …, and without ``meta``."""
    channels: dict[str, np.ndarray[Any, Any]] = {}
    units: dict[str, str] = {}
    for name, values in trace.channels.items():
        columns = {name: values} if values.ndim == 1 else {f"{name}_{i}": x for i, x in enumerate(values.T)}
        channels |= columns
        if name in trace.units:
            units |= dict.fromkeys(columns, trace.units[name])
    return Trace(trace.times, channels, units)
