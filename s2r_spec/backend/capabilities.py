"""The protocol of a backend, which turns a test into a trace, and what else a backend may be able to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend.model import Channel, Effect, Parameter
from s2r_spec.trace import Trace


@runtime_checkable
class Backend(Protocol):
    """A simulator, a robot or a recording."""

    @property
    def name(self) -> str:
        """Name and options, as in ``--backend`` ("twin:lab")."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every channel of every trace, with units."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every test parameter, with units, ranges and defaults."""

    @property
    def deterministic(self) -> bool:
        """Whether the same parameters and seed give the same trace, bit for bit.

        Whatever ran before it and in whichever process. A run tests this once.
        """

    @property
    def duration(self) -> float:
        """Duration of a trace [s], unless the rollout fails early."""

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s], for planning."""

    @property
    def model_hash(self) -> str:
        """Hash that changes whenever the traces could (constants, gains, solver versions)."""

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test. A fall or a crash sets ``meta["failure"]`` and raises nothing."""


@runtime_checkable
class HasDuration(Protocol):
    """A backend whose rollouts can be made longer or shorter."""

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with rollouts of this duration [s]."""


@runtime_checkable
class HasPictures(Protocol):
    """A backend that can draw a rollout."""

    def render(self, params: Mapping[str, float], seed: int, path: str | Path) -> Trace:
        """Run one test and draw it into a file.

        Raises:
            UsageError: it cannot be drawn on this computer.
        """


@dataclass(frozen=True)
class Drawn:
    """Pictures of a trace.

    Attributes:
        images: (n, height, width, 3) of 8 bits, one for each time.
        missing: what the trace lacks, and how that was drawn instead; each in one sentence.
    """

    images: NDArray[np.uint8]
    missing: tuple[str, ...]


@runtime_checkable
class HasTracePictures(Protocol):
    """A backend that can draw a trace from its channels, whichever machine it is of."""

    def draw_trace(
        self, trace: Trace, params: Mapping[str, float], times: Sequence[float], beside: Trace
    ) -> Drawn:
        """Draw a trace at times [s]; what it lacks is as in a simulated trace of the same test.

        Raises:
            UsageError: it cannot be drawn on this computer.
        """


@dataclass(frozen=True)
class Recording:
    """A recorded rollout.

    Attributes:
        source: its file.
        params: parameters of its test, or of its protocol.
        trace: its trace.
        protocol: name of its protocol; "" for a test of a specification.
    """

    source: str
    params: Mapping[str, float]
    trace: Trace
    protocol: str = ""


@runtime_checkable
class HasRecordings(Protocol):
    """A backend that only returns recordings: its tests are fixed, and no test can be added."""

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """Every recording once, with parameters in the backend's units; runs of protocols have their names."""


@runtime_checkable
class HasEffects(Protocol):
    """A backend that can add unmodelled effects to itself."""

    def effects(self) -> tuple[Effect, ...]:
        """Return the catalogue of effects."""

    def with_effects(self, values: Mapping[str, Mapping[str, float]]) -> Self:
        """Return this backend with these effects added: effect → parameter → value."""


@runtime_checkable
class HasChosen(Protocol):
    """A backend that reports its added effects; a diagnosis then looks for effects on top of them."""

    def chosen(self) -> Mapping[str, Mapping[str, float]]:
        """Return effect → parameter → value of all effects set by ``with_effects`` or by options."""


@runtime_checkable
class HasResiduals(Protocol):
    """A backend that computes residuals: the part of a recorded motion that its model does not explain.

    Scalar robustness hides most effects, and feedback hides the others in the controlled channels: a weak motor shows
    in its torque, not in the controlled speed. A residual is zero, up to noise and numerics, wherever the recorded
    motion, commands and forces agree with the nominal model, for every controller.

    If ``with_effects(values)`` computes the residuals of the model with these effects, a diagnosis also estimates
    the size of each effect from the equations of motion.
    """

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return the residuals of a recorded trace: a pure function of trace and test, much cheaper than a rollout.

        Args:
            trace: trace with channels of this backend. Other channels are ignored, and residuals that need a missing
                channel are left out.
            params: parameters of the test, if the model depends on them (a declared payload); a missing parameter
                takes the backend's default. Of a protocol's trace (``meta["protocol"]``), those of the protocol.

        Returns:
            Channels (n,) or (n, k) with units, over the trace's times or a part of them. The times do not depend on
            the added effects. Samples at the ends that a filter or a derivative cannot give are cut off, not padded.
            ``meta["parts"]`` names for every channel the robot part of each column ("FR calf", "base", "IMU").

        Raises:
            TraceError: the trace lacks the channels of every residual; the message lists them.
        """


@runtime_checkable
class HasControlLaw(Protocol):
    """A simulator that computes the commands of its controller from recorded channels, without a simulation.

    The law is the same on the machine, so a recording that breaks it has a mistake, whatever the machine's physics is.
    What acts in the controller's eyes, such as a sensor's error, is an effect of ``with_effects(values).commands``.
    """

    def commands(self, trace: Trace, params: Mapping[str, float]) -> Trace:
        """Return the commands that the law gives at the times of a recorded trace: a pure function, bit for bit.

        Args:
            trace: trace with channels of this backend.
            params: parameters of its test; a missing one takes its default.

        Returns:
            Channels that the controller or its recorder computes from the test and other channels, by their names in
            the trace, (n,) or (n, k). NaN where the law says nothing, as at the first sample or at saturation. What
            cannot be computed is left out.
        """


@runtime_checkable
class HasVariants(Protocol):
    """A simulator with equally valid ways to compute the same physics.

    Another time step, contact model or noise level is not a cause of a gap. A diagnosis ignores differences of the size
    that such variants make.
    """

    def variants(self) -> Mapping[str, Backend]:
        """Return name → this simulator with one idealisation replaced by an equally valid one."""


def is_exclusive(backend: object) -> bool:
    """Return whether a backend is a machine, which exists only once.

    Such a backend has the class attribute ``exclusive = True``. Its rollouts run one at a time in one worker process of
    this computer. The operator confirms each of them, and each repetition.
    """
    return bool(getattr(backend, "exclusive", False))


def hands_over(backend: object) -> bool:
    """Return whether ``rollout`` only records a test that a person ran during ``Attended.before``.

    Such a backend has the class attribute ``hands_over = True``. A process that dies in such a rollout does not end a
    test. So the rollout is not void, and is recorded again.
    """
    return bool(getattr(backend, "hands_over", False))


def assumptions_of(backend: object) -> tuple[str, ...]:
    """Return the assumptions of every statement about a backend, one sentence each: ``backend.assumptions``."""
    return tuple(getattr(backend, "assumptions", ()))


VOID = "void"
"""Definition: ``trace.meta["void"]`` is a word for what ended a rollout, if that was not the robot ("link").

Such a rollout is kept and has no outcome: the same test runs again. ``trace.meta["reason"]`` is the reason as a
sentence.
"""


@runtime_checkable
class Prepares(Protocol):
    """A backend whose worker must prepare before a rollout, for instance compile code or read a file.

    The time limit of a rollout does not include this time.
    """

    def prepare(self) -> None:
        """Prepare the worker process.

        Called once for a simulator. For a machine it is called before every rollout, and before the question to the
        operator.
        """


@runtime_checkable
class KeepsRaw(Protocol):
    """A backend that records more than its traces."""

    def keeping(self, folder: str) -> Self:
        """Return this backend with its raw recordings in a folder; no file is ever overwritten."""


@runtime_checkable
class SaysWhenItBegins(Protocol):
    """A machine whose rollouts begin long after their call, for instance because the robot stands up first."""

    def saying(self, begins: Callable[[], None]) -> Self:
        """Return this backend with rollouts that call ``begins`` at t = 0, from which ``--timeout`` counts."""


@dataclass(frozen=True)
class Needs:
    """The channels and parameters that a specification needs from a backend.

    Attributes:
        channels: channels that the requirement reads, in the units of the spec.
        parameters: parameters of a test, in the units of the spec; for a fixed one, both ends are its value.
        score: returns ρ of a trace and its test, as a search does; raises an S2RError if there is none.
    """

    channels: tuple[Channel, ...]
    parameters: tuple[Parameter, ...]
    score: Callable[[Trace, Mapping[str, float]], float]


@runtime_checkable
class NeedsSpec(Protocol):
    """A backend without its own channels and parameters: the specification defines them."""

    def for_spec(self, needs: Needs) -> Self:
        """Return this backend with these channels and parameters; open nothing."""


Level = Literal["ok", "note", "wrong"]


@dataclass(frozen=True)
class Finding:
    """One fact of a pre-flight check.

    Attributes:
        topic: one word for its subject, such as ``joints``.
        words: the fact, as a sentence.
        level: ``wrong`` if the backend cannot be right as it is, ``note`` if a person should look at it, else ``ok``.
        table: lines of a table that belongs to it.
        certain: whether a mistake in the loop explains it exactly, and no physics does.
    """

    topic: str
    words: str
    level: Level = "ok"
    table: tuple[str, ...] = ()
    certain: bool = False


LOG = "log"
"""Definition: topic of a finding about a log as such: its rate, its clock, how late it is."""


@runtime_checkable
class HasPreflight(Protocol):
    """A backend that was put together from a user's files, and can check whether they fit."""

    def preflight(self, *, run: bool) -> Iterator[Finding]:
        """Yield facts, each as soon as it is known; without ``run`` only those that need no rollout."""


@dataclass(frozen=True)
class Option:
    """An option after the colon of a backend's name, as NAME=VALUE.

    Attributes:
        name: name of the option.
        default: value of a missing option; None if the option is required.
        description: meaning of the option.
    """

    name: str
    default: str | None
    description: str


@runtime_checkable
class HasOptions(Protocol):
    """A factory of backends whose name needs options.

    Attributes:
        offered: the options.
        example: options that make a backend.
    """

    offered: tuple[Option, ...]
    example: str
