"""The `emps` backend: its declarations, and its rollouts."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import InitVar, dataclass, field, replace
from functools import cache
from importlib.metadata import version
from math import ceil
from pathlib import Path
from typing import Any, Self

import numpy as np

from s2r_emps import residuals
from s2r_emps.axis import DriveCommand, DriveLog, simulate
from s2r_emps.effects import CATALOGUE, world
from s2r_emps.moves import PARAMETERS, Test, move, read_test
from s2r_emps.noise import FloatArray, Noise, draw
from s2r_emps.physics import GAIN, MIDDLE, RATE, STEP, Physics
from s2r_emps.protocols import PROTOCOLS, reference
from s2r_emps.recorded import RecordedReference, read_recorded
from s2r_spec.backend import Channel, Effect, Parameter
from s2r_spec.effects import Choice, Values, as_values, choose, read_options, words
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.protocols import PLAYED, PROTOCOL, Protocol, named
from s2r_spec.trace import Trace

_CHANNELS = (
    Channel("q_ref", "m", "reference position"),
    Channel("q", "m", "position from the motor's encoder"),
    Channel("v", "m/s", "speed that the drive feeds back: the difference of two positions over 1 ms"),
    Channel("u", "V", "the controller's output, after saturation; 0 while the drive is off"),
    Channel("force", "N", "the drive's nominal force: the nominal force per volt times u"),
)

_CPU_PER_SECOND = 0.00025
"""Time of one core per simulated second [s], measured on a 2-core cloud machine."""


@dataclass(frozen=True)
class EmpsBackend:
    """A motor-driven prismatic axis under its cascade controller at 1 kHz; friction is an added effect.

    The machine is EMPS (Janot, Gautier and Brunot 2019), with its own controller. A rollout is a pure function of its
    parameters and its seed.
    """

    options: InitVar[str] = ""
    """Options after the colon of the name: ``coulomb.force=20`` adds an effect, and ``reference=FILE.mat`` follows a
    recorded reference instead of the built-in move."""
    duration: float = 2.5
    noise: Noise = field(default_factory=Noise)
    physics: Physics = field(default_factory=Physics)
    reference: str = ""
    """File of the EMPS data set; "" for the built-in move."""
    added: Choice = ()
    """Added effects; :meth:`with_effects` sets them."""
    channels: tuple[Channel, ...] = field(default=_CHANNELS, init=False, repr=False)
    deterministic: bool = field(default=True, init=False)

    def __post_init__(self, options: str) -> None:
        """Read the options, and round the duration up to a whole tick."""
        values, added = read_options("emps", options, {"reference": ()}, CATALOGUE.values(), self.added)
        reference = values.get("reference", self.reference)
        object.__setattr__(self, "reference", reference)
        object.__setattr__(self, "added", added)
        object.__setattr__(self, "duration", ceil(self.duration * RATE - 1e-9) / RATE)
        if reference and self.duration > self._recorded.length:
            raise UsageError(
                f"the reference {reference} is {self._recorded.length:g} s long, shorter than a rollout of "
                f"{self.duration:g} s; shorten the spec's windows"
            )

    @property
    def name(self) -> str:
        """Name for ``load_backend``, with options and effects."""
        return ":".join(filter(None, ("emps", _write_options(self.reference, self.added))))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the built-in move; for a recorded reference, the start of a rollout in it."""
        if not self.reference:
            return PARAMETERS
        last = round(self._recorded.length - self.duration, 9)
        return (Parameter("start", "s", 0.0, last, 0.0, "time in the record at which the rollout begins"),)

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s]."""
        return self.duration * _CPU_PER_SECOND

    @property
    def model_hash(self) -> str:
        """Hex digest over constants, noise, reference, NumPy's version and this package's source."""
        digest = self._recorded.digest if self.reference else ""
        return _digest(world(self.physics, self.added), self.noise, digest)

    @property
    def _recorded(self) -> RecordedReference:
        return read_recorded(self.reference)

    def effects(self) -> tuple[Effect, ...]:
        """Return the catalogue of effects that the nominal axis leaves out."""
        return tuple(CATALOGUE.values())

    def chosen(self) -> Values:
        """Return effect → parameter → value of the added effects."""
        return as_values(self.added)

    def with_effects(self, values: Values) -> Self:
        """Return this backend with these effects added: ``{"coulomb": {"force": 20.0}}``.

        Raises:
            UsageError: an effect or a parameter is unknown, or a value out of range.
        """
        return replace(self, added=choose("emps", CATALOGUE.values(), self.added, values))

    def variants(self) -> dict[str, Self]:
        """Return name → this axis with another, equally valid screw or noise."""
        from s2r_emps.variants import variants

        return {
            name: replace(self, physics=physics, noise=noise)
            for name, (physics, noise) in variants(self.physics, self.noise).items()
        }

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with rollouts of this duration [s], rounded up to a whole tick."""
        return replace(self, duration=seconds)

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test; samples every 1 ms from t = 0 to ``duration`` inclusive.

        Raises:
            UsageError: a parameter is unknown or out of range.
        """
        values = read_test(params, self.parameters)
        physics = world(self.physics, self.added)
        ticks = round(self.duration * RATE) + 1
        lead = 0
        if self.reference:
            reference, lead, start = self._recorded.part(values["start"], ticks)
            on = np.ones(reference.size, dtype=np.bool_)
            draws = draw(self.noise, seed, reference.size)
        else:
            test = Test(**values)
            reference, on = move(test, ticks)
            draws = draw(self.noise, seed, ticks)
            start = (float(reference[0]) + draws.start, 0.0)
            physics = replace(physics, mass=physics.mass + test.payload + draws.payload)
        record = simulate(DriveCommand.following(reference, on), start, physics, draws)
        return self._trace(reference[lead:], record.part(lead), {"params": values, "seed": seed})

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the excitation protocols; see :class:`s2r_spec.protocols.HasProtocols`."""
        return PROTOCOLS

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol; samples every 1 ms from its begin to its duration inclusive.

        Raises:
            UsageError: there is no such protocol, or a parameter is unknown or out of range.
        """
        values = named(PROTOCOLS, protocol, self.name).values(params)
        position, on = reference(protocol, values["amplitude"])
        draws = draw(self.noise, seed, position.size)
        start = (float(position[0]) + draws.start, 0.0)
        physics = world(self.physics, self.added)
        if "payload" in values:
            physics = replace(physics, mass=physics.mass + values["payload"] + draws.payload)
        record = simulate(DriveCommand.following(position, on), start, physics, draws, values["gain"])
        return self._trace(position, record, {PROTOCOL: protocol, "params": values, "seed": seed})

    def play(self, inputs: Trace, params: Mapping[str, float], seed: int) -> Trace:
        """Play the recorded voltage ``u`` instead of the controller's; the recording begins at rest.

        The carriage starts at the recording's first ``q``, or in the middle of the axis without one. Of ``params`` only
        the payload acts. See :class:`s2r_spec.protocols.HasInputs`.

        Raises:
            TraceError: the recording has no ``u``, or its samples are not 1 ms apart.
            UsageError: a parameter is unknown or out of range.
        """
        values = read_test(params, self.parameters)
        if not np.allclose(np.diff(inputs.times), STEP, rtol=0.0, atol=0.01 * STEP):
            raise TraceError(
                "the axis plays a voltage with samples 1 ms apart; resample the trace to 0.001 s"
            )
        voltage = inputs["u"]
        draws = draw(self.noise, seed, voltage.size)
        physics = world(self.physics, self.added)
        physics = replace(physics, mass=physics.mass + values.get("payload", 0.0) + draws.payload)
        begin = float(inputs["q"][0]) if "q" in inputs.channels else MIDDLE
        reference_position = inputs["q_ref"] if "q_ref" in inputs.channels else np.full(voltage.size, begin)
        command = DriveCommand(reference_position, np.zeros(voltage.size, dtype=np.bool_), voltage)
        record = simulate(command, (begin, 0.0), physics, draws)
        return self._trace(reference_position, record, {PROTOCOL: PLAYED, "params": values, "seed": seed})

    def _trace(self, reference_position: FloatArray, record: DriveLog, facts: dict[str, Any]) -> Trace:
        columns = (reference_position, record.q, record.v, record.u, record.force)
        meta: dict[str, Any] = {"backend": self.name, "model_hash": self.model_hash, **facts}
        if self.added:
            meta["effects"] = as_values(self.added)
        return Trace(
            STEP * np.arange(reference_position.size, dtype=np.float64),
            {channel.name: column for channel, column in zip(_CHANNELS, columns, strict=True)},
            {channel.name: channel.unit for channel in _CHANNELS},
            meta,
        )

    def commands(self, trace: Trace, params: Mapping[str, float]) -> Trace:
        """Return what the drive computes: ``q_ref`` of the test, ``v`` of two positions, ``u`` and ``force``.

        See :class:`s2r_spec.backend.HasControlLaw`. ``u`` is the law before saturation; it is NaN where the drive is
        off or may be saturated.
        """
        law: dict[str, np.ndarray] = {}
        have, physics = trace.channels, world(self.physics, self.added)
        if not residuals.is_even(trace):
            return trace.only(())
        if "q_ref" in have:
            values = read_test(params, self.parameters)
            if self.reference:
                position, lead, _ = self._recorded.part(values["start"], len(trace))
                law["q_ref"] = position[lead:]
            else:
                law["q_ref"] = move(Test(**values), len(trace))[0]
        if {"q", "v"} <= set(have):
            law["v"] = residuals.speed(trace, physics)
            law["v"][0] = np.nan  # nothing is known of the position before
        if {"q", "q_ref", "u"} <= set(have):
            law["u"] = residuals.unsaturated_voltage(trace, physics)
        if {"u", "force"} <= set(have):
            law["force"] = GAIN * have["u"]
        return trace.only(law).with_channels(lambda name, _: law[name])

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return the force and the voltage that this model, with its effects, does not explain.

        See :func:`s2r_emps.residuals.residuals`; of ``params`` only the payload is used, and the gain of a protocol.
        """
        protocol, known = str(trace.meta.get(PROTOCOL, "")), self.parameters
        if protocol == PLAYED:
            trace = trace.only(name for name in trace.channels if name != "q_ref")
        elif protocol:
            known = named(PROTOCOLS, protocol, self.name).parameters
        values = read_test(params or {}, known)
        physics = world(self.physics, self.added)
        physics = replace(physics, mass=physics.mass + values.get("payload", 0.0))
        return residuals.residuals(trace, physics, values.get("gain", 1.0))


def _write_options(reference: str, added: Choice) -> str:
    return ",".join(([f"reference={reference}"] if reference else []) + words(added))


@cache
def _digest(physics: Physics, noise: Noise, reference: str) -> str:
    """Hash the values in use and the source, because a changed formula changes traces like a changed gain."""
    digest = hashlib.sha256(f"{physics!r} {noise!r} {reference} numpy {version('numpy')}".encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
