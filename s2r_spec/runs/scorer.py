"""A scorer makes the task of a test's rollout, and evaluates a measure, such as ρ, on the trace."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Self

from s2r_spec.backend import Backend, Channel, Needs, NeedsSpec, Parameter, installed, is_exclusive
from s2r_spec.base.errors import BackendError, S2RError, UsageError
from s2r_spec.runs.compatibility import check_compatibility
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.runs.task import Done, Task, open_backend, with_rollout_duration
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

Measure = Callable[[Trace, Mapping[str, float]], float]
"""A number from a trace and its test: positive if the test was passed, and by how much."""


def default_timeout(backend: Backend) -> float:
    """Return the default limit on a rollout's CPU time [s], far above the backend's declared cost.

    A backend that is not deterministic may wait for people, and has no limit.
    """
    return 60.0 + 100.0 * backend.cost if backend.deterministic else math.inf


@dataclass(frozen=True)
class Scorer:
    """A measure on the rollouts of one backend, which every worker opens by its name unless it was passed as an object.

    Attributes:
        measure: the function that scores a trace that did not fail.
        fall: value of a rollout that failed, declared before the data.
        to_backend: converts a test point to the backend's parameters and units.
        channels: those that the measure reads; None for all.
    """

    name: str
    backend: Backend
    measure: Measure
    fall: float
    to_backend: Callable[[Mapping[str, float]], dict[str, float]] = dict
    channels: tuple[str, ...] | None = None
    passed: PassedBackend | None = None

    @classmethod
    def for_spec(
        cls, spec: Spec, requirement: str, backend: str | Backend, duration: float | None = None
    ) -> Self:
        """Open the backend with rollouts as long as the requirement's horizon; a UsageError if the two do not fit."""
        name, system = open_system(backend, _horizon(spec, requirement) if duration is None else duration)
        settings = spec.certify.get(requirement)
        if settings is None or settings.fall is None:
            raise UsageError(
                f"{spec.name} declares no ρ for a rollout that falls; "
                f"write a line such as `certify {requirement}: fall = -1`"
            )

        robustness, system = _robustness(spec, requirement), adapt_to_spec(system, spec, requirement)
        matched = check_compatibility(spec, requirement, system)
        passed = None if isinstance(backend, str) else pass_backend(system)
        return cls(name, system, robustness, settings.fall, matched.to_backend, matched.channels, passed)

    def task(self, query: int, replicate: int, point: Mapping[str, float], seed: int) -> Task:
        """Return the task of one rollout at a test point."""
        return Task(
            query=query,
            replicate=replicate,
            backend=self.name,
            params=self.to_backend(point),
            seed=seed,
            duration=self.backend.duration,
            # A simulator gives the same trace again for the same seed, so that only the channels of the measure are
            # kept. A trace that cannot be repeated is kept whole.
            channels=self.channels if self.backend.deterministic else None,
            model_hash=self.backend.model_hash,
            timeout=default_timeout(self.backend),
            passed=self.passed,
        )

    def score(self, point: Mapping[str, float], done: Done) -> tuple[float, str | None]:
        """Return ρ of a rollout, and the word for its failure if it failed.

        A fall or a crash has its declared value. It is never dropped, and its incomplete trace is never evaluated.

        Raises:
            S2RError: the measure raised, or returned no finite number.
        """
        if done.trace is None or done.failure is not None:
            return self.fall, done.failure or "crash"
        if done.trace.failure is not None:
            return self.fall, done.trace.failure
        try:
            value = self.measure(done.trace, point)
        except S2RError:
            raise
        except Exception as error:
            raise BackendError(f"its measure raised {type(error).__name__}: {error}") from error
        return _number(value), None


def open_system(backend: str | Backend, duration: float | None) -> tuple[str, Backend]:
    """Return the name of a backend, and the backend with rollouts of ``duration`` seconds if that is given."""
    if isinstance(backend, str):
        if backend.partition(":")[0] not in installed():
            open_backend.cache_clear()  # a file may have changed since an earlier run of this process
        return backend, open_backend(backend, duration)
    return backend.name, with_rollout_duration(backend, backend.name, duration)


def open_for_requirement(spec: Spec, requirement: str, backend: Backend) -> Backend:
    """Return a backend with the duration, the channels and the parameters that a requirement needs of it."""
    return adapt_to_spec(open_system(backend, _horizon(spec, requirement))[1], spec, requirement)


def adapt_to_spec(system: Backend, spec: Spec, requirement: str) -> Backend:
    """Return a backend with the channels and parameters of the spec, if it has none of its own."""
    if not isinstance(system, NeedsSpec):
        return system
    adapted = system.for_spec(needs_of(spec, requirement, _robustness(spec, requirement)))
    assert isinstance(adapted, Backend)
    return adapted


def _horizon(spec: Spec, requirement: str) -> float | None:
    """Return the duration of rollouts that a requirement needs [s]; None if it reads a trace to its end."""
    horizon = spec.horizon(requirement)
    return horizon if math.isfinite(horizon) and horizon > 0 else None


def _robustness(spec: Spec, requirement: str) -> Measure:
    def robustness(trace: Trace, point: Mapping[str, float]) -> float:
        return spec.robustness(trace, params=point, only=requirement)[requirement]

    return robustness


def pass_backend(backend: Backend) -> PassedBackend:
    """Return a backend object for its rollouts; a UsageError refuses a machine whose process cannot have a copy."""
    passed = PassedBackend(backend)
    if is_exclusive(backend) and not passed.portable:
        raise UsageError(
            f"{backend.name} is a machine, and a process of its own runs its rollouts; move its class to a module"
        )
    return passed


def needs_of(spec: Spec, requirement: str, measure: Measure) -> Needs:
    """Return the channels and parameters that a requirement needs of a backend, in the units of the spec."""
    signals = [spec.signals[name] for name in spec.channels(requirement)]
    parameters = []
    for name, param in spec.params.items():
        ends = param.range if param.searched else None
        if ends is None and param.default is not None:
            ends = param.default, param.default
        if ends is not None:
            parameters.append(Parameter(name, param.unit, *ends, ends[0], "as the spec declares it"))
    channels = [Channel(one.name, one.unit, "as the spec reads it", one.dim) for one in signals]
    return Needs(tuple(channels), tuple(parameters), measure)


def _number(value: object) -> float:
    scalar = hasattr(value, "__float__") and getattr(value, "ndim", 0) == 0
    if scalar and not isinstance(value, str | bytes | complex):
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            pass
        else:
            if math.isfinite(number):
                return number
            raise BackendError(f"its ρ is {number}")
    shape = f" of shape {shape}" if (shape := getattr(value, "shape", ())) else ""
    what = "None" if value is None else f"a value of type {type(value).__name__}{shape}"
    raise BackendError(f"its measure gave {what}, not a number")
