"""The backend under check, the result of a requirement on it, and the runs that all requirements share."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from s2r_spec.backend import Backend, Effect, EffectParameter, Parameter
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_values import Shown
from s2r_spec.runs.repeatability import difference
from s2r_spec.trace import Trace

Values = dict[str, dict[str, float]]

SEED = 1
HALF = 0.5
"""Definition: size of a tested effect, as a share of the distance from nominal to the farther end of its range."""
SLACK = 1.5
"""Tolerance: difference between a rollout's duration and the declared one, in samples."""


@dataclass
class Check(Shown):
    """The result of one requirement on a backend.

    Attributes:
        requirement: the requirement on the backend, as a sentence.
        words: the requirement.
        violations: one sentence per violation.
        broken: one sentence for each violation of the requirement.
        remarks: one sentence for each fact that is allowed, but may not be intended.
    """

    requirement: str
    violations: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    JSON = "words=requirement broken=violations remarks"


class Subject:
    """A backend under check, its default test and that test's rollouts."""

    def __init__(self, backend: Backend) -> None:
        self.backend: Any = backend  # each requirement knows which further methods it has

    @cached_property
    def test(self) -> dict[str, float]:
        """The default test."""
        return {p.name: p.default for p in self.backend.parameters}

    @cached_property
    def first(self) -> Trace:
        """The rollout of the default test."""
        return rollout(self.backend, self.test)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The catalogue; an effect that the backend reports as added has its added value as nominal."""
        return catalogue_of(self.backend)

    @cached_property
    def half_effects(self) -> dict[str, Values]:
        """Every effect at half size, set by its first parameter that changes the trace on its own."""
        return {effect.name: self._half(effect) for effect in self.effects}

    def _half(self, effect: Effect) -> Values:
        candidates = [{effect.name: {p.name: towards(p, HALF)}} for p in effect.parameters]
        changing = (
            one for one in candidates if not is_same(self.first, rollout(self.with_effects(one), self.test))
        )
        return next(changing, candidates[0]) if self.backend.deterministic else candidates[0]

    def with_effects(self, values: Mapping[str, Mapping[str, float]], base: Any = None) -> Any:
        """Return the backend, or ``base``, with these effects.

        Raises:
            TypeError: the result is not a backend.
        """
        changed = (self.backend if base is None else base).with_effects(values)
        if not isinstance(changed, Backend):
            raise TypeError(
                f"with_effects({dict(values)}) returns {type(changed).__name__}, which is not a backend"
            )
        return changed


Checks = tuple[tuple[str, Callable[[Subject, Check], None]], ...]
"""Requirements on a backend, as sentences, and the functions that check them."""


def rollout(backend: Any, test: Mapping[str, float]) -> Trace:
    """Return the rollout of a test.

    Raises:
        TypeError: the result is not a trace.
    """
    trace = backend.rollout(test, SEED)
    if not isinstance(trace, Trace):
        raise TypeError(f"rollout returns {type(trace).__name__}, which is not a Trace")
    return trace


def attempt(out: Check, at: str, noun: str, run: Callable[[], object]) -> Trace | None:
    """Return the trace of a rollout or a run; an exception is a violation, and an early end a remark."""
    try:
        trace = run()
    except (Exception, SystemExit) as error:  # third-party code may raise anything
        out.violations.append(
            f"{at}: {describe(error)}; a {noun} that cannot go on must end with meta['failure']"
        )
        return None
    if not isinstance(trace, Trace):
        out.violations.append(f"{at}: {noun} returns {type(trace).__name__}, which is not a Trace")
        return None
    if trace.failure is not None:
        out.remarks.append(f"{at}: ends early ({trace.failure})")
    return trace


def describe(error: BaseException) -> str:
    """Return an exception's type and message."""
    return f"{type(error).__name__}: {error}"


def is_same(one: Trace, other: Trace) -> bool:
    """Return whether two traces are the same, bit for bit."""
    return one.channels.keys() == other.channels.keys() and difference(one, other) is None


def towards(parameter: EffectParameter, share: float) -> float:
    """Return the value at this share of the distance from nominal to the farther end of the range."""
    low, high, nominal = parameter.low, parameter.high, parameter.nominal
    return nominal + share * ((high if high - nominal >= nominal - low else low) - nominal)


def repeated(kind: str, names: Iterable[str]) -> list[str]:
    """Return a violation for each name that is declared more than once."""
    counts = Counter(names).items()
    return [f"the {kind} {name} is declared {count} times" for name, count in counts if count > 1]


def wrong_defaults(parameters: Iterable[Parameter], before: str = "") -> list[str]:
    """Return a violation for each parameter whose default is outside its range, or whose range is infinite."""
    return [
        f"{before}{p.name} has the default {p.default:g} in [{p.low:g}, {p.high:g}] {p.unit}".rstrip()
        for p in parameters
        if not (p.low <= p.default <= p.high and math.isfinite(p.high - p.low))
    ]


def lasts(trace: Trace, seconds: float) -> bool:
    """Return whether a trace has a duration [s], or ends early."""
    step = float(np.diff(trace.times).max()) if len(trace) > 1 else 0.0
    return trace.failure is not None or abs(trace.duration - seconds) <= SLACK * step


def rms(values: FloatArray) -> float:
    """Return the root mean square of the finite values."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0
