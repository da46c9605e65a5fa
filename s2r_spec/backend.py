"""What makes traces: the protocol that a backend implements, and how one is found by name.

A backend is a class offered through the entry-point group ``s2r.backends``. It
says what it can do before anything runs, and then turns a test into a trace.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

from s2r_spec.errors import (
    BackendError,
    MissingPackageError,
    S2RError,
    UnknownBackendError,
    UsageError,
    did_you_mean,
    one_of,
)
from s2r_spec.trace import Trace

GROUP = "s2r.backends"


@dataclass(frozen=True)
class Channel:
    """A channel that every trace of the backend carries.

    Attributes:
        name: as specs have it.
        unit: of all its columns.
        description: what it is, in a line.
        width: how many columns it has.
        columns: name of each of them ("FR hip"), for what is told of one; empty where they have numbers alone.
    """

    name: str
    unit: str
    description: str
    width: int = 1
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.columns and len(self.columns) != self.width:
            raise UsageError(
                f"channel {self.name} has {self.width} columns, but names for {len(self.columns)}: name all or none"
            )


@dataclass(frozen=True)
class Parameter:
    """A test parameter that the backend accepts, with the range it can really do."""

    name: str
    unit: str
    low: float
    high: float
    default: float
    description: str

    def check(self, value: float) -> float:
        """Return the value as a float, or say which range it must lie in."""
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise UsageError(
                f"{self.name} = {value!r} is no number; the backend takes [{self.low:g}, {self.high:g}] {self.unit}"
            ) from None
        if not self.low <= number <= self.high:
            raise UsageError(
                f"{self.name} = {number:g} {self.unit} is outside what the backend can do: "
                f"[{self.low:g}, {self.high:g}] {self.unit}"
            )
        return number


def refuse_unknown(name: str, parameters: Iterable[Parameter], params: Iterable[str]) -> None:
    """Refuse a test with a parameter that a backend does not declare: the rollout would be of another test.

    Args:
        name: of the backend.
        parameters: that it declares.
        params: names of the test's.

    Raises:
        UsageError: see there.
    """
    known = [parameter.name for parameter in parameters]
    for other in params:
        if other not in known:
            raise UsageError(
                f"the backend {name!r} has no parameter {other!r}{did_you_mean(other, known)}; it has {one_of(known)}"
            )


def read_test(name: str, parameters: Iterable[Parameter], params: Mapping[str, float]) -> dict[str, float]:
    """Return the value of every parameter that a backend declares; one that is not given takes its default.

    Args:
        name: of the backend.
        parameters: that it declares.
        params: of the test.

    Raises:
        UsageError: a parameter is not declared, is no number, or is outside its range.
    """
    parameters = tuple(parameters)
    refuse_unknown(name, parameters, params)
    return {p.name: p.check(params.get(p.name, p.default)) for p in parameters}


@runtime_checkable
class Backend(Protocol):
    """A simulator, a robot or a recording.

    Attributes:
        name: what ``--backend`` says, with its options ("twin:lab").
        channels: every channel of every trace, with units.
        parameters: every test parameter, with units, ranges and defaults.
        deterministic: the same parameters and seed give the same trace, bit for bit.
        duration: length of a trace [s], unless the rollout fails early.
        cost: expected time of one rollout on one core [s], for planning.
        model_hash: changes whenever the traces could (figures, gains, solver versions).
    """

    @property
    def name(self) -> str:
        """What ``--backend`` says, with its options."""
        ...

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every channel of every trace."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every test parameter."""
        ...

    @property
    def deterministic(self) -> bool:
        """Whether parameters and seed fix the trace."""
        ...

    @property
    def duration(self) -> float:
        """Length of a trace [s]."""
        ...

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s]."""
        ...

    @property
    def model_hash(self) -> str:
        """Hex digest over everything that decides a trace."""
        ...

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test. A fall or a crash is no exception: set ``meta["failure"]``."""
        ...


@runtime_checkable
class HasDuration(Protocol):
    """A backend whose rollouts can be made longer or shorter."""

    def with_duration(self, seconds: float) -> Self:
        """Return the same backend with rollouts of this length."""
        ...


@runtime_checkable
class HasPictures(Protocol):
    """A backend that can draw a rollout."""

    def render(self, params: Mapping[str, float], seed: int, path: str | Path) -> Trace:
        """Run one test and draw it; a UsageError says why it cannot be drawn here."""
        ...


@dataclass(frozen=True)
class Recording:
    """A rollout that already happened: the file it was read from, its test, and what came of it."""

    source: str
    params: Mapping[str, float]
    trace: Trace


@runtime_checkable
class HasRecordings(Protocol):
    """A backend that runs nothing: its tests were fixed before, and none can be added."""

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """Every recording, each once, with parameters in the backend's units."""
        ...


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect; at its nominal value the effect does nothing."""

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    prior: str


@dataclass(frozen=True)
class Effect:
    """One unmodelled piece of physics that a backend can add to itself."""

    name: str
    family: str
    physics: str
    parameters: tuple[EffectParameter, ...]


@runtime_checkable
class HasEffects(Protocol):
    """A backend that can add unmodelled effects to itself."""

    def effects(self) -> tuple[Effect, ...]:
        """Return the catalogue."""
        ...

    def with_effects(self, values: Mapping[str, Mapping[str, float]]) -> Self:
        """Return the same backend with these effects added."""
        ...


@runtime_checkable
class HasChosen(Protocol):
    """A backend that says which effects it was given: what a diagnosis looks for is then beyond these."""

    def chosen(self) -> Mapping[str, Mapping[str, float]]:
        """Return effect → parameter → value of all that was set by ``with_effects`` or by its options."""
        ...


@runtime_checkable
class HasResiduals(Protocol):
    """A backend that can say what of a recorded motion its own model leaves unexplained.

    Scalar robustness hides most effects, and feedback hides the rest in the
    controlled channels: a weak motor is seen in the torque that was needed,
    not in the speed that was held. A residual is zero, up to noise and
    numerics, where the recorded motion, commands and forces agree with the
    nominal model, whatever the controller did.

    Where the residuals of ``with_effects(values)`` are those of the model with these
    effects, a diagnosis also asks how much of each effect the equations want.
    """

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return the residuals of a recorded trace: a pure function of trace and test, cheap beside a rollout.

        Args:
            trace: of this backend's channels; more channels are ignored, and residuals
                that need a missing one are left out.
            params: the test that was run, where the model depends on it (a declared
                payload); what is missing takes the backend's default.

        Returns:
            Channels (n,) or (n, k) with units, over the trace's times or a part of
            them, the same whatever effects were added; differences that a filter or a
            derivative cannot give at the ends are cut off, not padded. ``meta["parts"]``
            gives, for every channel, the names of what its columns belong to, one each
            ("FR calf", "base", "IMU").

        Raises:
            TraceError: the trace has none of the channels that any residual needs; the
                message lists what would be needed.
        """
        ...


@runtime_checkable
class HasVariants(Protocol):
    """A simulator that can compute the same physics otherwise.

    Another time step, contact model or noise level is nobody's cause of a gap:
    a diagnosis believes no difference that is as large as theirs.
    """

    def variants(self) -> Mapping[str, Backend]:
        """Return name → the same simulator with one idealisation exchanged for another as good."""
        ...


def is_exclusive(backend: object) -> bool:
    """Return whether a backend is a machine of which there is one.

    A backend says so by a class attribute ``exclusive = True``. Its rollouts then run one at a time in one worker
    process on this machine, each after its operator's word; nothing else opens it, and none is run again without one.
    """
    return bool(getattr(backend, "exclusive", False))


def hands_over(backend: object) -> bool:
    """Return whether ``rollout`` only hands over a test that a person ran while ``Attended.before`` waited.

    A backend says so by a class attribute ``hands_over = True``. A process that dies in such a rollout ended no test,
    so that nothing is void; the rollout is handed over again.
    """
    return bool(getattr(backend, "hands_over", False))


def assumptions_of(backend: object) -> tuple[str, ...]:
    """Return what every statement about a backend assumes of it, each in one sentence: ``backend.assumptions``."""
    return tuple(getattr(backend, "assumptions", ()))


VOID = "void"
"""Definition: ``trace.meta["void"]`` is a word for what ended a rollout, when that was not the robot ("link").

Such a rollout is kept and is no outcome: the same test runs again. ``trace.meta["reason"]`` has a sentence.
"""


class Operator(Protocol):
    """The person at the terminal. Where there is no terminal, every question raises a UsageError at once."""

    def say(self, text: str) -> None:
        """Show a text; without a terminal it goes to standard error."""
        ...

    def type_word(self, question: str, word: str) -> None:
        """Return when exactly this word was typed; Enter alone and other words are asked again.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        ...

    def choose(self, question: str, answers: Mapping[str, str]) -> str:
        """Return the key that was typed, of key → what it means; "" among the keys is Enter alone.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        ...

    def line(self, question: str) -> str:
        """Return the line that was typed, such as the path of a file.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        ...


@dataclass(frozen=True)
class Coming:
    """What a run is about to do to a machine.

    Attributes:
        rollouts: at most; None if nobody knows.
    """

    rollouts: int | None


class Attended(Protocol):
    """What a backend does in the process that holds the terminal; a worker never reads one.

    An attribute ``unattended = True`` says that nobody is asked. Without it a run without a terminal is refused
    before anything is opened, and after a void rollout the operator says whether the same test runs again.

    An attribute ``answers``, name → text, is what the operator said of the machine in the last ``before``, such as the
    lights of its battery: it is kept with the rollout, in the journal and in the trace's ``meta["answers"]``.
    """

    def begin(self, coming: Coming) -> None:
        """Get the machine ready, and get the operator's consent: before the first rollout."""
        ...

    def before(self, params: Mapping[str, float]) -> None:
        """Return when the rollout of this test may be handed to the worker.

        Raises:
            NotBegunError: it may not; the operator is asked whether to try again.
            StoppedError: the operator ends the run.
        """
        ...

    def after(self, trace: Trace | None) -> None:
        """Follow a rollout: its trace is recorded by now; None if it left none, or never began."""
        ...

    def interrupt(self, urgent: bool) -> None:
        """Bring the machine to rest while a rollout runs; ``urgent``, by the second Ctrl-C, at once. Returns soon."""
        ...

    def end(self) -> None:
        """Leave the machine at rest: after the last rollout, or whatever else ended the run, ``begin`` too."""
        ...


@runtime_checkable
class HasAttendance(Protocol):
    """A machine whose rollouts need a person, or a guard of it, in the process that holds the terminal."""

    def attendance(self, operator: Operator) -> Attended:
        """Return who attends to the rollouts of a run; opens nothing."""
        ...


@runtime_checkable
class Prepares(Protocol):
    """A machine whose worker has something to do before it can run a rollout at once: to compile, to read a file."""

    def prepare(self) -> None:
        """Get this process ready: in the worker, before the operator is asked; called before every rollout."""
        ...


@runtime_checkable
class KeepsRaw(Protocol):
    """A backend that records more than its traces."""

    def keeping(self, folder: str) -> Self:
        """Return the same backend, whose rollouts add files of their own to this folder; none is ever overwritten."""
        ...


@runtime_checkable
class SaysWhenItBegins(Protocol):
    """A machine whose rollouts begin well after they are asked for: it stands up before a test."""

    def saying(self, begins: Callable[[], None]) -> Self:
        """Return the same backend, whose rollouts call ``begins`` at t = 0; ``--timeout`` counts from then on."""
        ...


@dataclass(frozen=True)
class Needs:
    """What a specification asks of a backend.

    Attributes:
        channels: that the requirement reads, in the units of the spec.
        parameters: of a test, in the units of the spec; one that the spec fixes has its value as both ends.
        score: ρ of a trace and its test, as a search computes it; an S2RError says why there is none.
    """

    channels: tuple[Channel, ...]
    parameters: tuple[Parameter, ...]
    score: Callable[[Trace, Mapping[str, float]], float]


@runtime_checkable
class NeedsSpec(Protocol):
    """A backend without channels and parameters of its own: it records whatever a specification asks for."""

    def for_spec(self, needs: Needs) -> Self:
        """Return the same backend with these channels and parameters; opens nothing."""
        ...


@dataclass(frozen=True)
class Option:
    """What may follow the colon of a backend's name, as NAME=VALUE.

    Attributes:
        name: of the option.
        default: what holds where it is not given; None if it must be given.
        description: of what it says.
    """

    name: str
    default: str | None
    description: str


@runtime_checkable
class HasOptions(Protocol):
    """A factory of backends that cannot be made of their bare name.

    Attributes:
        offered: the options.
        example: of them, that makes a backend.
    """

    offered: tuple[Option, ...]
    example: str


def installed() -> dict[str, EntryPoint]:
    """Return name → entry point of every installed backend, without importing any of them."""
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=GROUP):
        if point.name in found and point.value != found[point.name].value:
            raise BackendError(
                f"two installed packages offer a backend named {point.name!r}: "
                f"{found[point.name].value} and {point.value}; uninstall one of them"
            )
        found[point.name] = point
    return dict(sorted(found.items()))


@cache
def _factory(name: str) -> Any:
    points = installed()
    if name not in points:
        raise UnknownBackendError(name, points)
    try:
        return points[name].load()
    except ModuleNotFoundError as error:
        raise MissingPackageError(name, error.name or str(error)) from error


def short(model_hash: str) -> str:
    """Return what stands for a model hash where people compare: twelve digits at most; of words, digits of them all."""
    if len(model_hash) > 12 and not re.fullmatch("[0-9a-f]+", model_hash):
        model_hash = sha256(model_hash.encode()).hexdigest()
    return model_hash[:12]


def load_backend(name: str) -> Backend:
    """Make the backend called ``name``; what follows a colon goes to the backend as text.

    ``load_backend("sim")`` calls the class behind the entry point ``sim``
    without arguments, ``load_backend("twin:lab")`` calls ``twin`` with ``"lab"``.

    Raises:
        UnknownBackendError: no installed package offers it; the message lists those that are.
        MissingPackageError: it is offered, but something it imports is not installed.
        BackendError: what the entry point makes is not a backend.
    """
    kind, colon, argument = name.partition(":")
    factory = _factory(kind)
    try:
        backend = factory(argument) if colon else factory()
        if colon and hasattr(backend, "chosen"):
            backend.chosen()  # a class without options takes them for its first field, and fails much later
    except S2RError:
        raise
    except Exception as error:
        raise BackendError(f"backend {name!r} cannot be made: {type(error).__name__}: {error}") from error
    if not isinstance(backend, Backend):
        lacking = [word for word in _REQUIRED if not hasattr(backend, word)]
        raise BackendError(f"backend {name!r} ({type(backend).__name__}) lacks {', '.join(lacking)}")
    return backend


def described(name: str) -> tuple[Backend, tuple[Option, ...]]:
    """Return a backend to describe, and its options; one that needs some, and has none, with those of its example.

    Raises:
        BackendError: as :func:`load_backend`.
    """
    kind, colon, _ = name.partition(":")
    factory = _factory(kind)
    if not isinstance(factory, HasOptions):
        return load_backend(name), ()
    return load_backend(name if colon else f"{kind}:{factory.example}"), factory.offered


_REQUIRED = ("name", "channels", "parameters", "deterministic", "duration", "cost", "model_hash", "rollout")
