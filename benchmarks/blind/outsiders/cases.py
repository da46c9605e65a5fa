"""Blind cases of a machine with code of its own: what ails it is drawn, and it is run at tests over the space."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import log
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.random import Generator

from benchmarks.blind.emps.cases import CaseKind
from s2r_spec.spec import Spec, load_spec
from s2r_spec.trace import Trace

BUDGET, DIFFERENT = 30, 20
"""Rollouts of a case and different tests among them; the others are repeats, two of a test."""
SIZES = (0.5, 1.5)
"""Of its typical size: how large an effect is, log-uniform between."""
BACKGROUND = 0.04
"""Of its typical size: the standard deviation of every effect that the case is not about."""
PROBES = 6
"""Of its tests at which is measured how far a case's effects move ρ."""

Test = dict[str, float]
Rollouts = list[tuple[Test, Trace]]


@dataclass(frozen=True)
class Cause:
    """One effect.

    Attributes:
        name: the catalogue's, where it is in the catalogue.
        parameter: what its number is called.
        made: size → its number; the typical size is 1.
        nominal: its number where it is not there.
        signed: whether its size can be negative.
        sizes: how large it is, log-uniform between.
        background: standard deviation of its size in cases that are not about it.
        also: further numbers of the machine that say how it acts; they go into the label.
        relative_of: the catalogue member that it resembles.
        where: numbers of the machine → where it acts: ``window`` in s or ``place`` in m.
    """

    name: str
    parameter: str
    made: Callable[[float], float]
    nominal: float = 0.0
    signed: bool = False
    sizes: tuple[float, float] = SIZES
    background: float = BACKGROUND
    also: tuple[str, ...] = ()
    relative_of: str | None = None
    where: Callable[[Mapping[str, float]], dict[str, list[float]]] | None = None


def linear(name: str, parameter: str, typical: float, nominal: float = 0.0, signed: bool = False) -> Cause:
    """Return a cause whose number differs from nominal by its size times what is typical."""
    return Cause(name, parameter, lambda size: nominal + size * typical, nominal, signed)


class Machine(Protocol):
    """What a module must have to be the real machine of a set; ``drive`` takes what ``drawn_nuisance`` gave.

    ``drawn_body(rng)``, where there is one, returns further numbers that differ from machine to machine.
    """

    VERSION: str
    SPEC: Path
    KNOWN: tuple[Cause, ...]
    UNKNOWN: tuple[Cause, ...]
    drawn_nuisance: Callable[[Generator], Any]
    drive: Callable[[Mapping[str, float], Mapping[str, float], Any], Trace]


@dataclass(frozen=True)
class Case:
    """One case: the real runs, further runs at other tests for scoring alone, and what is to be found out."""

    rollouts: Rollouts
    held_out: Rollouts
    label: dict[str, Any]


def make_case(machine: Machine, rng: Generator, kind: CaseKind, held_out: int = 0) -> Case:
    """Draw everything that a case is made of, and run it; ``held_out`` runs more are for nobody to diagnose from."""
    spec = load_spec(machine.SPEC)
    causes = chosen(machine, rng, kind)
    others = background(machine, rng, causes)
    values = {cause.name: cause.made(size_of(cause, rng)) for cause in causes}
    others |= getattr(machine, "drawn_body", lambda rng: {})(rng)
    tests, further = drawn_tests(spec, rng), stratified(spec, rng, held_out)
    nuisances = [machine.drawn_nuisance(rng) for _ in (*tests, *further)]
    runs = [
        (test, machine.drive(others | values, test, nuisance))
        for test, nuisance in zip((*tests, *further), nuisances, strict=True)
    ]
    label: dict[str, Any] = {
        "kind": kind,
        "effects": _numbers(causes, others | values),
        "background": _numbers([cause for cause in machine.KNOWN if cause not in causes], others),
        "relative_of": causes[0].relative_of if causes else None,
        "generator": machine.VERSION,
    }
    for cause in causes:
        if cause.where:
            ends = cause.where(others | values)
            label["where"] = {name: [round(end, 4) for end in pair] for name, pair in ends.items()}
    if causes:
        away = [
            abs(_rho(spec, test, trace) - _rho(spec, test, machine.drive(others, test, nuisance)))
            for (test, trace), nuisance in zip(runs[:PROBES], nuisances, strict=False)
        ]
        label["moved"] = float(f"{np.mean(away):.4g}")
    return Case(runs[: len(tests)], runs[len(tests) :], label)


def _numbers(causes: Sequence[Cause], values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    return {
        cause.name: {
            label: float(f"{values[name]:.6g}")
            for label, name in ((cause.parameter, cause.name), *((also, also) for also in cause.also))
        }
        for cause in causes
    }


def _rho(spec: Spec, test: Test, trace: Trace) -> float:
    return spec.robustness(trace, test)[spec.requirements[0]]


def chosen(machine: Machine, rng: Generator, kind: CaseKind) -> list[Cause]:
    """Draw which effects a case has."""
    count = {"null": 0, "single": 1, "pair": 2, "triple": 3, "unknown": 1}[kind]
    group = machine.UNKNOWN if kind == "unknown" else machine.KNOWN
    return [group[int(k)] for k in rng.choice(len(group), count, replace=False)]


def size_of(cause: Cause, rng: Generator) -> float:
    """Draw how large an effect is, as a multiple of what is typical."""
    size = float(np.exp(rng.uniform(*map(log, cause.sizes))))
    return -size if cause.signed and rng.uniform() < 0.5 else size


def background(machine: Machine, rng: Generator, causes: list[Cause]) -> dict[str, float]:
    """Draw a little of every effect of the catalogue that is none of the causes."""
    values = {}
    for cause in machine.KNOWN:
        size = cause.background * float(rng.normal())
        if cause not in causes:
            values[cause.name] = cause.made(size if cause.signed else abs(size))
    return values


def drawn_tests(spec: Spec, rng: Generator) -> list[Test]:
    """Return tests evenly over the test space, a quarter of the different ones three times, shuffled."""
    single = stratified(spec, rng, DIFFERENT)
    again = rng.choice(DIFFERENT, (BUDGET - DIFFERENT) // 2, replace=False)
    tests = single + [single[int(k)] for k in again for _ in range(2)]
    return [tests[int(k)] for k in rng.permutation(len(tests))]


def stratified(spec: Spec, rng: Generator, count: int) -> list[Test]:
    """Return ``count`` tests of the spec's test space: on every axis, one in each of as many equal parts."""
    if not count:
        return []
    space = spec.space
    parts = np.stack([rng.permutation(count) for _ in range(space.dim)], axis=1)
    unit = (parts + rng.uniform(size=parts.shape)) / count
    points = space.lower + (space.upper - space.lower) * unit
    return [{name: round(value, 4) for name, value in space.point(point).items()} for point in points]
