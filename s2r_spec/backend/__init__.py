"""The protocol of a backend, which turns a test into a trace; and the registry that finds a backend by its name.

A package offers a backend as a class in the entry-point group ``s2r.backends``. A backend declares its channels,
parameters and effects before anything runs.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

from s2r_spec.base.distribution import BACKENDS
from s2r_spec.base.errors import (
    BackendError,
    MissingPackageError,
    S2RError,
    UnknownBackendError,
    UsageError,
    did_you_mean,
    one_of,
)
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Channel:
    """A channel that every trace of the backend has.

    Attributes:
        name: name in specs.
        unit: unit of all columns.
        description: meaning, in one line.
        width: number of columns.
        columns: name of each column ("FR hip"), for messages; empty if columns only have numbers.
    """

    name: str
    unit: str
    description: str
    width: int = 1
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.columns and len(self.columns) != self.width:
            raise UsageError(
                f"the channel {self.name} has {self.width} columns, but {len(self.columns)} names of columns: name all "
                f"or none"
            )


@dataclass(frozen=True)
class Parameter:
    """A test parameter that the backend accepts, with the range that it can run."""

    name: str
    unit: str
    low: float
    high: float
    default: float
    description: str

    def check(self, value: Any) -> float:
        """Return the value as a float in this parameter's unit.

        Args:
            value: a number in this unit, a text with a unit ("30 cm/s"), or a pint Quantity.

        Raises:
            UsageError: the value is not a number, lies outside the range, or has a unit that does not fit.
        """
        if not isinstance(value, float | int):
            value = self._read(value)
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise UsageError(
                f"{self.name} = {value!r} is not a number; its range is [{self.low:g}, {self.high:g}] {self.unit}"
            ) from None
        if not self.low <= number <= self.high:
            raise UsageError(
                f"{self.name} = {number:g} {self.unit} is outside the backend's range "
                f"[{self.low:g}, {self.high:g}] {self.unit}"
            )
        return number

    def _read(self, value: Any) -> Any:
        """Return a value that has a unit as a number in this parameter's unit; any other value unchanged."""
        from s2r_spec.lang.amounts import Quantity, read_amount
        from s2r_spec.lang.units import UnknownUnitError, parse_unit

        if not isinstance(value, str | Quantity):
            return value
        try:
            return read_amount(value, parse_unit(self.unit), self.name)
        except UnknownUnitError:
            raise UsageError(
                f"{self.name} = {value!r}: the backend declares it in {self.unit!r}, which is not a unit; give a number"
            ) from None


def refuse_unknown(name: str, parameters: Iterable[Parameter], params: Iterable[str]) -> None:
    """Refuse a test with an undeclared parameter, because the rollout would run a different test.

    Args:
        name: name of the backend.
        parameters: parameters that the backend declares.
        params: names of the test's parameters.

    Raises:
        UsageError: the backend does not declare one of them.
    """
    known = [parameter.name for parameter in parameters]
    for other in params:
        if other not in known:
            raise UsageError(
                f"the backend {name!r} has no parameter {other!r}{did_you_mean(other, known)}; it has {one_of(known)}"
            )


def read_test(name: str, parameters: Iterable[Parameter], params: Mapping[str, float]) -> dict[str, float]:
    """Return the value of every declared parameter; a missing one takes its default.

    Args:
        name: name of the backend.
        parameters: parameters that the backend declares.
        params: parameters of the test.

    Raises:
        UsageError: a parameter is not declared, is not a number, or is outside its range.
    """
    parameters = tuple(parameters)
    refuse_unknown(name, parameters, params)
    return {p.name: p.check(params.get(p.name, p.default)) for p in parameters}


@runtime_checkable
class Backend(Protocol):
    """A simulator, a robot or a recording.

    Attributes:
        name: name and options, as in ``--backend`` ("twin:lab").
        channels: every channel of every trace, with units.
        parameters: every test parameter, with units, ranges and defaults.
        deterministic: whether the same parameters and seed give the same trace, bit for bit, whatever ran before and
            in whichever process. A run tests this once.
        duration: duration of a trace [s], unless the rollout fails early.
        cost: expected time of one rollout on one core [s], for planning.
        model_hash: hash that changes whenever the traces could (constants, gains, solver versions).
    """

    @property
    def name(self) -> str:
        """Name and options, as in ``--backend``."""
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
        """Whether parameters and seed determine the trace."""
        ...

    @property
    def duration(self) -> float:
        """Duration of a trace [s]."""
        ...

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s]."""
        ...

    @property
    def model_hash(self) -> str:
        """Hex digest over everything that determines a trace."""
        ...

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test. A fall or a crash sets ``meta["failure"]`` and raises nothing."""
        ...


@runtime_checkable
class HasDuration(Protocol):
    """A backend whose rollouts can be made longer or shorter."""

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with rollouts of this duration [s]."""
        ...


@runtime_checkable
class HasPictures(Protocol):
    """A backend that can draw a rollout."""

    def render(self, params: Mapping[str, float], seed: int, path: str | Path) -> Trace:
        """Run one test and draw it into a file.

        Raises:
            UsageError: it cannot be drawn on this computer.
        """
        ...


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
        """Return the catalogue of effects."""
        ...

    def with_effects(self, values: Mapping[str, Mapping[str, float]]) -> Self:
        """Return this backend with these effects added: effect → parameter → value."""
        ...


@runtime_checkable
class HasChosen(Protocol):
    """A backend that reports its added effects; a diagnosis then looks for effects on top of them."""

    def chosen(self) -> Mapping[str, Mapping[str, float]]:
        """Return effect → parameter → value of all effects set by ``with_effects`` or by options."""
        ...


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
        ...


@runtime_checkable
class HasVariants(Protocol):
    """A simulator with equally valid ways to compute the same physics.

    Another time step, contact model or noise level is not a cause of a gap. A diagnosis ignores differences of the size
    that such variants make.
    """

    def variants(self) -> Mapping[str, Backend]:
        """Return name → this simulator with one idealisation replaced by an equally valid one."""
        ...


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


class Operator(Protocol):
    """The person at the terminal. Without a terminal every question raises a UsageError at once."""

    def say(self, text: str) -> None:
        """Show a text; without a terminal, on standard error."""
        ...

    def type_word(self, question: str, word: str) -> None:
        """Ask until the person types exactly this word.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        ...

    def choose(self, question: str, answers: Mapping[str, str]) -> str:
        """Return the key that the person types, one of key → meaning; the key "" is Enter alone.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        ...

    def line(self, question: str) -> str:
        """Return the line that the person types, such as the path of a file.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        ...


@dataclass(frozen=True)
class Coming:
    """The rollouts that a run plans on a machine.

    Attributes:
        rollouts: largest number of rollouts; None if unknown.
    """

    rollouts: int | None


class Attended(Protocol):
    """The part of a machine's backend that runs in the process with the terminal; a worker has no terminal.

    With an attribute ``unattended = True`` no question is asked. Without it, a run without a terminal is refused before
    anything is opened, and the operator decides after a void rollout whether the same test runs again.

    An optional attribute ``answers``, name → text, holds the operator's answers in the last ``before``, such as the
    lights of the battery. The journal and the trace's ``meta["answers"]`` keep them.
    """

    def begin(self, coming: Coming) -> None:
        """Prepare the machine and ask for the operator's consent, before the first rollout."""
        ...

    def before(self, params: Mapping[str, float]) -> None:
        """Return when the rollout of this test may begin.

        Raises:
            NotBegunError: the rollout may not begin; the operator decides whether to try again.
            StoppedError: the operator ends the run.
        """
        ...

    def after(self, trace: Trace | None) -> None:
        """Finish a rollout, whose trace is recorded; None if it left no trace or did not begin."""
        ...

    def interrupt(self, urgent: bool) -> None:
        """Bring the machine to rest during a rollout; at once if ``urgent``, after a second Ctrl-C. Returns soon."""
        ...

    def end(self) -> None:
        """Leave the machine at rest after the last rollout, or after any other end of the run."""
        ...


@runtime_checkable
class HasAttendance(Protocol):
    """A machine whose rollouts need a person or a guard in the process with the terminal."""

    def attendance(self, operator: Operator) -> Attended:
        """Return the attendance of a run's rollouts; open nothing."""
        ...


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
        ...


@runtime_checkable
class KeepsRaw(Protocol):
    """A backend that records more than its traces."""

    def keeping(self, folder: str) -> Self:
        """Return this backend with its raw recordings in a folder; no file is ever overwritten."""
        ...


@runtime_checkable
class SaysWhenItBegins(Protocol):
    """A machine whose rollouts begin long after their call, for instance because the robot stands up first."""

    def saying(self, begins: Callable[[], None]) -> Self:
        """Return this backend with rollouts that call ``begins`` at t = 0, from which ``--timeout`` counts."""
        ...


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
        ...


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


def installed() -> dict[str, EntryPoint]:
    """Return name → entry point of every installed backend, without any import of them."""
    points: dict[str, EntryPoint] = {}
    for point in entry_points(group=BACKENDS):
        if point.name in points and point.value != points[point.name].value:
            raise BackendError(
                f"two installed packages offer a backend named {point.name!r}: "
                f"{points[point.name].value} and {point.value}; uninstall one of them"
            )
        points[point.name] = point
    return dict(sorted(points.items()))


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
    """Return at most twelve digits of a model hash, for people; a hash with other characters is hashed first."""
    if len(model_hash) > 12 and not re.fullmatch("[0-9a-f]+", model_hash):
        model_hash = sha256(model_hash.encode()).hexdigest()
    return model_hash[:12]


def load_backend(name: str) -> Backend:
    """Make the backend called ``name``; the backend gets the text after a colon as its argument.

    ``load_backend("sim")`` calls the class of the entry point ``sim`` without arguments, and
    ``load_backend("twin:lab")`` calls ``twin`` with ``"lab"``.

    Raises:
        UnknownBackendError: no installed package offers it; the message lists the installed backends.
        MissingPackageError: the backend imports a package that is not installed.
        BackendError: the entry point raised an error, or its result is not a backend.
    """
    kind, colon, argument = name.partition(":")
    factory = _factory(kind)
    try:
        backend = factory(argument) if colon else factory()
        if colon and hasattr(backend, "chosen"):
            backend.chosen()  # a class without options stores them in its first field, and fails much later
    except S2RError:
        raise
    except Exception as error:
        raise BackendError(f"backend {name!r} cannot be opened: {type(error).__name__}: {error}") from error
    if words := fault(backend):
        raise BackendError(f"backend {name!r} ({type(backend).__name__}) {words}")
    found: Backend = backend
    return found


def described(name: str) -> tuple[Backend, tuple[Option, ...]]:
    """Return a backend to describe, and its options; it gets its example's options if required ones are missing.

    Raises:
        BackendError: as :func:`load_backend`.
    """
    kind, colon, _ = name.partition(":")
    factory = _factory(kind)
    if not isinstance(factory, HasOptions):
        return load_backend(name), ()
    return load_backend(name if colon else f"{kind}:{factory.example}"), factory.offered


def fault(backend: object) -> str:
    """Return how an object breaks the protocol :class:`Backend`, as words after its name; "" if it keeps it."""
    lacking = [word for word in _REQUIRED if not hasattr(backend, word)]
    if lacking:
        return f"lacks {', '.join(lacking)} of the protocol Backend"
    assert isinstance(backend, Backend)
    try:
        signature = inspect.signature(backend.rollout)
    except (TypeError, ValueError):  # not a function; or one of a library, which does not tell
        return "" if callable(backend.rollout) else "has a rollout that is not a method"
    try:
        signature.bind({}, 0)
    except TypeError:
        return f"has rollout{signature}, but it is called with a test and a seed: rollout(params, seed)"
    for word, kind in (("channels", Channel), ("parameters", Parameter)):
        declared = getattr(backend, word)
        if isinstance(declared, str | Mapping) or not all(isinstance(one, kind) for one in declared):
            return f"has {word} = {declared!r}; they must be a tuple of s2r.{kind.__name__}"
    return ""


_REQUIRED = ("name", "channels", "parameters", "deterministic", "duration", "cost", "model_hash", "rollout")
