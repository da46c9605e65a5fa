"""Blind cases: an axis with one effect, several, an unknown one or none, run at tests drawn from the test space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import log
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.random import Generator

from benchmarks.blind.emps.axis import GTAU, run
from benchmarks.blind.emps.kinds import KNOWN, NEAR, UNLIKE, Kind
from benchmarks.blind.emps.machine import TICK, Machine, Nuisance, drawn_nuisance
from s2r_emps.moves import Test, move, read_test
from s2r_spec.space import Space
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace

VERSION = "emps/4"
"""Of this generator; it goes into every label."""
SPEC = Path(__file__).parents[3] / "specs" / "emps_tracking.stl"
DURATION = 2.5
"""[s]"""

CaseKind = Literal["single", "pair", "triple", "unknown", "null"]
KINDS: tuple[CaseKind, ...] = get_args(CaseKind)
MIX: Mapping[CaseKind, float] = {"single": 0.5, "pair": 0.2, "triple": 0.05, "unknown": 0.15, "null": 0.1}
BACKGROUND = 0.05
"""Of its largest size: the standard deviation of every effect that the case is not about."""
PROBES = 6
"""Of its tests at which is measured how far a case's effects move ρ."""
_UNITS = {"q_ref": "m", "q": "m", "v": "m/s", "u": "V", "force": "N"}

Rollouts = list[tuple[dict[str, float], Trace]]


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        rollouts: the real runs, (parameters, trace).
        held_out: further runs at other tests, for scoring alone.
        label: what is to be found out; JSON.
    """

    rollouts: Rollouts
    held_out: Rollouts
    label: dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """A case before it has run."""

    machine: Machine
    bare: Machine
    """The same without the effects that are to be found out."""
    tests: list[dict[str, float]]
    further: list[dict[str, float]]
    nuisances: list[Nuisance]
    label: dict[str, Any]


def make_case(rng: Generator, kind: CaseKind, budget: int = 30, held_out: int = 0) -> Case:
    """Make a case of this kind with ``budget`` rollouts, and ``held_out`` more that nobody diagnoses from."""
    return realise([plan(rng, kind, budget, held_out)])[0]


def plan(rng: Generator, kind: CaseKind, budget: int, held_out: int = 0) -> Plan:
    """Draw everything that a case is made of."""
    kinds = chosen(rng, kind)
    drawn = machine_of(rng, kinds)
    label: dict[str, Any] = {
        "kind": kind,
        "effects": drawn.effects,
        "background": drawn.background,
        "relative_of": kinds[0].relative_of if kinds else None,
        "generator": VERSION,
    }
    if drawn.where:
        label["where"] = drawn.where
    tests, further = drawn_tests(rng, budget), stratified(rng, held_out)
    nuisances = [drawn_nuisance(rng) for _ in range(budget + held_out)]
    return Plan(drawn.machine, drawn.bare, tests, further, nuisances, label)


def realise(plans: Sequence[Plan]) -> list[Case]:
    """Run the cases of these plans, all rollouts side by side."""
    cases = [
        Case(runs[: len(each.tests)], runs[len(each.tests) :], dict(each.label))
        for each, runs in zip(
            plans, _runs([(e.machine, (*e.tests, *e.further), e.nuisances) for e in plans]), strict=True
        )
    ]
    moved = [(each, case) for each, case in zip(plans, cases, strict=True) if each.label["effects"]]
    others = _runs([(e.bare, e.tests[:PROBES], e.nuisances[: len(e.tests[:PROBES])]) for e, _ in moved])
    for (_, case), bare in zip(moved, others, strict=True):
        away = [
            abs(_rho(trace, test) - _rho(other, test))
            for (test, trace), (_, other) in zip(case.rollouts, bare, strict=False)
        ]
        case.label["moved"] = float(f"{np.mean(away):.4g}")
    return cases


def _rho(trace: Trace, test: Mapping[str, float]) -> float:
    spec = load_spec(SPEC)
    return spec.robustness(trace, dict(test))[spec.requirements[0]]


def _runs(asked: Sequence[tuple[Machine, Sequence[dict[str, float]], Sequence[Nuisance]]]) -> list[Rollouts]:
    """Run every machine at its tests, all side by side."""
    if not asked:
        return []
    tests = [test for _, some, _ in asked for test in some]
    ticks = round(DURATION / TICK) + 1
    moves = [move(Test(**read_test(test)), ticks) for test in tests]
    references, powered = np.stack([m[0] for m in moves]), np.stack([m[1] for m in moves])
    logs = run(
        [machine for machine, some, _ in asked for _ in some],
        [test.get("payload", 0.0) for test in tests],
        references,
        powered,
        [nuisance for _, _, nuisances in asked for nuisance in nuisances],
    )
    times = TICK * np.arange(ticks)
    traces = [
        Trace(times, {"q_ref": asked, "q": q, "v": v, "u": u, "force": GTAU * u}, _UNITS)
        for asked, q, v, u in zip(references, logs["q"], logs["v"], logs["u"], strict=True)
    ]
    out, rest = [], iter(zip(tests, traces, strict=True))
    for _, some, _ in asked:
        out.append([next(rest) for _ in some])
    return out


def chosen(rng: Generator, kind: CaseKind) -> list[Kind]:
    """Draw which effects a case has."""
    if kind == "null":
        return []
    if kind == "unknown":
        group = UNLIKE if rng.uniform() < 0.5 else NEAR
        return [group[int(rng.integers(len(group)))]]
    count = {"single": 1, "pair": 2, "triple": 3}[kind]
    return [KNOWN[str(name)] for name in rng.choice(sorted(KNOWN), count, replace=False)]


Labels = dict[str, dict[str, float]]
"""Effect → parameter → value."""


@dataclass(frozen=True)
class Drawn:
    """An axis.

    Attributes:
        machine: with its effects and a little of all others.
        bare: the same without its effects.
        effects: values of its effects.
        background: values of all others.
        where: ``window`` [s] or ``place`` [m] in which an effect acts.
    """

    machine: Machine
    bare: Machine
    effects: Labels
    background: Labels
    where: dict[str, list[float]]


def machine_of(rng: Generator, kinds: Sequence[Kind], background: float = BACKGROUND) -> Drawn:
    """Return an axis with these effects and a little of all others."""
    machine = Machine()
    if background:
        machine = replace(
            machine,
            bristle=float(rng.integers(2)),
            presliding=float(rng.uniform(5e-6, 3e-5)),
            creep=float(rng.uniform(5e-4, 2e-3)),
            lopsided=float(rng.normal(0.0, 0.05)),
            motor_share=float(rng.uniform(0.25, 0.35)),
            supply_time=float(rng.uniform(0.01, 0.06)),
        )
    names = {kind.name for kind in kinds}
    others: Labels = {}
    for kind in KNOWN.values():
        amount = background * kind.high * float(rng.normal())
        if amount and kind.name not in names:
            fields, values = kind.made(amount if kind.signed else abs(amount), rng)
            machine, others[kind.name] = replace(machine, **fields), _rounded(values)
    bare = machine
    effects: Labels = {}
    where: dict[str, list[float]] = {}
    for kind in kinds:
        size = float(np.exp(rng.uniform(log(kind.low), log(kind.high))))
        fields, values = kind.made(-size if kind.signed and rng.uniform() < 0.5 else size, rng)
        machine = replace(machine, **fields)
        effects[kind.name] = _rounded(values)
        if kind.where:
            where |= {name: [round(end, 4) for end in ends] for name, ends in kind.where(fields).items()}
    return Drawn(machine, bare, effects, others, where)


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(f"{value:.6g}") for name, value in values.items()}


def drawn_tests(rng: Generator, budget: int) -> list[dict[str, float]]:
    """Return ``budget`` tests evenly over the test space, a third of the different ones three times, shuffled."""
    repeated = (budget - max(1, round(budget * 3 / 5))) // 2
    single = stratified(rng, budget - 2 * repeated)
    again = rng.choice(len(single), repeated, replace=False)
    tests = single + [single[int(k)] for k in again for _ in range(2)]
    return [tests[int(k)] for k in rng.permutation(len(tests))]


@cache
def space_of_tests() -> Space:
    """Return the spec's."""
    return load_spec(SPEC).space


def stratified(rng: Generator, count: int) -> list[dict[str, float]]:
    """Return ``count`` tests of the spec's test space: on every axis, one in each of as many equal parts."""
    space = space_of_tests()
    if not count:
        return []
    parts = np.stack([rng.permutation(count) for _ in range(space.dim)], axis=1)
    unit = (parts + rng.uniform(size=parts.shape)) / count
    points = space.lower + (space.upper - space.lower) * unit
    return [{name: round(value, 4) for name, value in space.point(point).items()} for point in points]
