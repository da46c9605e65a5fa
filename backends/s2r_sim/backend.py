"""The `sim` backend: its channels, parameters and effects, and the rollout of a test."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import InitVar, dataclass, field, replace
from functools import cache, cached_property
from importlib.metadata import version
from importlib.util import find_spec
from math import ceil
from pathlib import Path
from typing import Any, Self, get_args

import numpy as np

from s2r_sim.controller.gains import RATE, Feedback, Form
from s2r_sim.effects import CATALOGUE, with_effects
from s2r_sim.parameters import PARAMETERS, read_test
from s2r_sim.plant.channels import CHANNELS, TRUE_CHANNELS
from s2r_sim.plant.noise import Noise
from s2r_sim.protocols import PROTOCOLS
from s2r_sim.robot.constants import FloatArray
from s2r_sim.settings import Record, Settings
from s2r_spec.backend import Channel, Effect, Parameter
from s2r_spec.effects import Choice, Values, as_values, choose, read_options, words
from s2r_spec.errors import MissingPackageError
from s2r_spec.protocols import PROTOCOL, Protocol, named
from s2r_spec.trace import Trace

_MODULES = ("mujoco", "numba", "pinocchio", "piqp")
_DISTRIBUTIONS = ("mujoco", "numba", "numpy", "pin", "piqp")

_OPTIONS: dict[str, tuple[str, ...]] = {
    "feedback": get_args(Feedback),
    "form": get_args(Form),
    "record": get_args(Record),
}
_ONLOOKERS = frozenset({"pictures.py", "residuals", "variants.py"})
"""Source files and folders that have no influence on a trace of this backend."""

_CPU_PER_SECOND = 0.08
"""[s] time of one core per simulated second, measured on a 2-core cloud machine."""


@dataclass(frozen=True)
class SimBackend:
    """Unitree's A1, trotting in MuJoCo under an inverse-dynamics QP solved by PIQP at 500 Hz.

    The robot trots in place until t = 0 of the trace. There the velocity command
    steps from zero to the test's value. A rollout is a pure function of its
    parameters and its seed.
    """

    options: InitVar[str] = ""
    """Options after the colon of the name. With ``feedback=estimate`` the controller runs on the robot's own
    velocity estimate instead of the true velocity. ``form=full`` chooses the 30-variable QP,
    ``record=truth`` adds channels such as ``q_true``, and ``latency.delay=0.004`` adds an effect."""
    duration: float = 1.5
    noise: Noise = field(default_factory=Noise)
    settings: Settings = field(default_factory=Settings)
    added: Choice = ()
    """Effects; set them with :meth:`with_effects`."""
    channels: tuple[Channel, ...] = field(default=CHANNELS, init=False, repr=False)
    parameters: tuple[Parameter, ...] = field(default=PARAMETERS, init=False, repr=False)
    deterministic: bool = field(default=True, init=False)

    def __post_init__(self, options: str) -> None:
        """Refuse a missing package, read the options, and round the duration to control ticks."""
        for module in _MODULES:
            if find_spec(module) is None:
                raise MissingPackageError("sim", module)
        values, added = read_options("sim", options, _OPTIONS, CATALOGUE.values(), self.added)
        settings = replace(self.settings, **values)  # type: ignore[arg-type]  # they are valid values
        object.__setattr__(self, "settings", settings)
        object.__setattr__(self, "added", added)
        if settings.record == "truth":
            object.__setattr__(self, "channels", CHANNELS + TRUE_CHANNELS)
        object.__setattr__(self, "duration", _ticks(self.duration) / RATE)

    @property
    def name(self) -> str:
        """Name from which ``load_backend`` builds this backend, with all effects."""
        return ":".join(filter(None, ("sim", write_options(self.settings, self.added))))

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s], once the process is warm."""
        return (self.duration + self.settings.settling) * _CPU_PER_SECOND

    @cached_property
    def _settings(self) -> Settings:
        """The settings with the effects in them."""
        return replace(self.settings, physics=with_effects(self.settings.physics, self.added))

    @cached_property
    def model_hash(self) -> str:
        """Hex digest over constants, gains, noise, physics, solver versions and this package's source."""
        return _digest(self._settings, self.noise)

    def effects(self) -> tuple[Effect, ...]:
        """Return the catalogue of physics that the nominal simulator leaves out."""
        return tuple(CATALOGUE.values())

    def chosen(self) -> dict[str, dict[str, float]]:
        """Return effect → parameter → value, for each effect that was set."""
        return as_values(self.added)

    def with_effects(self, values: Values) -> Self:
        """Return the same backend with these effects added: ``{"motor_strength": {"factor": 0.8}}``.

        Effects change the simulated world alone; the controller's model stays the same.

        Raises:
            UsageError: an effect or a parameter is unknown, or a value out of range.
        """
        return replace(self, added=choose("sim", CATALOGUE.values(), self.added, values))

    def variants(self) -> dict[str, Self]:
        """Return name → the same physics with another time step, contact model or noise, each as plausible."""
        from s2r_sim.variants import variants

        return {
            name: replace(self, settings=settings, noise=noise)
            for name, (settings, noise) in variants(self.settings, self.noise).items()
        }

    def with_duration(self, seconds: float) -> Self:
        """Return the same backend with rollouts of this length, rounded up to a whole control tick."""
        return replace(self, duration=seconds)

    def prepare(self) -> None:
        """Compile what a rollout needs; in a new installation this takes 25 s of one core."""
        self.rollout({}, 0)

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test; samples every 2 ms from the command at t = 0 to ``duration`` inclusive.

        A fall ends the trace and sets ``meta["failure"]`` to "fall".

        Raises:
            UsageError: a parameter is unknown or out of range.
        """
        test = read_test(params)
        # Imported here: a list of backends needs no physics engine.
        from s2r_sim.rollout import simulator

        settings = self._settings
        settings = replace(settings, physics=test.world(settings.physics))
        record = simulator(settings).rollout(test, self.noise, seed, _ticks(self.duration) + 1)
        facts = {"params": test._asdict(), "seed": seed, "qp_failures": record.qp_failures}
        return self._trace(record.channels, record.fallen, facts)

    def _trace(self, channels: dict[str, FloatArray], fallen: bool, facts: dict[str, Any]) -> Trace:
        meta = {"backend": self.name, "model_hash": self.model_hash, **facts}
        if effects := self.chosen():
            meta["effects"] = effects
        if fallen:
            meta["failure"] = "fall"
        units = {channel.name: channel.unit for channel in self.channels if channel.name in channels}
        return Trace(np.arange(len(channels["x"])) / RATE, channels, units, meta)

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the excitation protocols; see :class:`s2r_spec.protocols.HasProtocols`."""
        return PROTOCOLS

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol; samples every 2 ms from its begin to its duration inclusive.

        A fall ends the trace and sets ``meta["failure"]`` to "fall".

        Raises:
            UsageError: there is no such protocol, or a parameter is unknown or out of range.
        """
        values = named(PROTOCOLS, protocol, self.name).values(params)
        from s2r_sim.protocols.references import reference
        from s2r_sim.protocols.simulator import protocol_simulator

        simulator, motion = protocol_simulator(self._settings), reference(protocol, **values)
        channels, fallen = simulator.run(motion, self.noise, seed)
        return self._trace(channels, fallen, {PROTOCOL: protocol, "params": values, "seed": seed})

    def render(self, params: Mapping[str, float], seed: int, path: str | Path) -> Trace:
        """Run one test and draw it: tiles of the gait (.png, .jpg) or a short video (.gif, .webp).

        Raises:
            UsageError: as :meth:`rollout`; or pictures cannot be drawn on this machine.
        """
        from s2r_sim.pictures import draw

        trace, true = self.rollout(params, seed), replace(self.settings, record="truth")
        true_trace = trace if self.settings == true else replace(self, settings=true).rollout(params, seed)
        settings = self._settings
        draw(replace(settings, physics=read_test(params).world(settings.physics)), true_trace, Path(path))
        return trace

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return the residuals of this simulator on a trace; see :class:`s2r_spec.backend.HasResiduals`.

        The model includes this backend's effects where they predict the record. Uneven ground does not: the
        trace has no height of the ground under a foot. A residual is positive if the outside world adds a
        quantity: a push forward is a positive ``base_force``.

        Raises:
            TraceError: no residual can be computed from the channels, or the trace is too short.
            UsageError: a parameter is unknown or out of range.
        """
        from s2r_sim.residuals import residuals

        return residuals(trace, self.settings, self.added, params)


def write_options(settings: Settings, added: Choice) -> str:
    """Return the text from which the options give these settings and effects, without defaults."""
    nominal = Settings()
    changed = [
        f"{name}={getattr(settings, name)}"
        for name in _OPTIONS
        if getattr(settings, name) != getattr(nominal, name)
    ]
    return ",".join(changed + words(added))


def _ticks(seconds: float) -> int:
    return ceil(seconds * RATE - 1e-9)


@cache
def _digest(settings: Settings, noise: Noise) -> str:
    """Hash the settings and the source code: a new formula changes traces as a new gain does."""
    digest = hashlib.sha256(f"{settings!r} {noise!r}".encode())
    for distribution in _DISTRIBUTIONS:
        digest.update(f" {distribution} {version(distribution)}".encode())
    here = Path(__file__).parent
    for path in sorted(here.rglob("*.py")):
        if path.relative_to(here).parts[0] not in _ONLOOKERS:
            digest.update(path.read_bytes())
    return digest.hexdigest()
