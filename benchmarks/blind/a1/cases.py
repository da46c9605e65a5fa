"""Blind cases: a twin with one effect, several, an unknown one or none, run at tests drawn from the test space."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import log
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.random import Generator

from benchmarks.blind.a1.effects import KNOWN, NEAR, UNLIKE, Kind
from benchmarks.blind.a1.model import Build, made
from benchmarks.blind.a1.rollout import Runner
from benchmarks.blind.a1.twin import Twin
from s2r_spec.spec import Spec, load_spec
from s2r_spec.trace import Trace

SPEC = Path(__file__).parents[3] / "specs" / "a1_velocity.stl"
VERSION = "a1/2"
"""Of this generator; it goes into every label."""

CaseKind = Literal["single", "pair", "triple", "unknown", "null"]
KINDS: tuple[CaseKind, ...] = get_args(CaseKind)
MIX: Mapping[CaseKind, float] = {"single": 0.5, "pair": 0.2, "triple": 0.05, "unknown": 0.15, "null": 0.1}
BACKGROUND = 0.05
"""Of its largest size: how much there is of every effect that the case is not about."""
RANGE = (-0.2, 0.3)
"""[m/s] the test space of specs/a1_velocity.stl."""
_PROBES = 5
"""Commands at which a label's ``moved`` is measured."""
_SHRINK, _TRIES = 0.75, 4
"""Where probes fall, sizes are multiplied by this, and so often at most."""


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        rollouts: the real runs, (parameters, trace).
        held_out: further runs at other tests, for scoring alone.
        label: what is to be found out; JSON.
    """

    rollouts: list[tuple[dict[str, float], Trace]]
    held_out: list[tuple[dict[str, float], Trace]]
    label: dict[str, Any]


def make_case(
    rng: Generator,
    kind: CaseKind,
    budget: int,
    held_out: int = 0,
    commands: Sequence[float] | None = None,
) -> Case:
    """Make a case of this kind with ``budget`` rollouts, and ``held_out`` more that nobody diagnoses from.

    ``commands`` are those of the rollouts [m/s], drawn if not given. Cases with the same ones share what a diagnosis
    simulates.
    """
    kinds = chosen(rng, kind)
    seed = int(rng.integers(2**62))
    most = {1: 1.0, 2: 0.8, 3: 0.65}.get(len(kinds), 1.0)
    size = {each.name: log_uniform(rng, each.low, most * each.high) for each in kinds}
    for _ in range(_TRIES):
        twin, effects = twin_of(kinds, size, seed)
        runner = Runner(twin)
        probes = [runner.run(vd, np.random.default_rng([seed, k])) for k, vd in enumerate(RANGE)]
        if not any(probe.failure for probe in probes):
            break
        size = {name: _SHRINK * value for name, value in size.items()}
    rollouts = [run(runner, vd, rng) for vd in (tests(rng, budget) if commands is None else commands)]
    further = [run(runner, vd, rng) for vd in stratified(rng, held_out)]
    label: dict[str, Any] = {
        "kind": kind,
        "effects": effects,
        "relative_of": kinds[0].relative_of if kinds else None,
        "background": background_of(seed, effects),
        "generator": VERSION,
    }
    if kinds:
        label["moved"] = moved(runner, Runner(twin_of([], {}, seed, without=size)[0]), seed)
    windows = [each.window(effects[each.name]) for each in kinds if each.window]
    if windows:
        label["where"] = {"window": list(windows[0])}
    return Case(rollouts, further, label)


def run(runner: Runner, vd: float, rng: Generator) -> tuple[dict[str, float], Trace]:
    """Return one rollout and its parameters."""
    vd = round(vd, 4)
    return {"vd": vd}, runner.run(vd, np.random.default_rng(int(rng.integers(2**62))))


def moved(runner: Runner, without: Runner, seed: int) -> float:
    """Return how far the effects of a case move ρ, mean |Δρ| over the test space, run by run under the same noise."""
    low, high = RANGE
    away = []
    for k, vd in enumerate(np.linspace(low, high, _PROBES).tolist()):
        pair = [each.run(vd, np.random.default_rng([seed, 9, k])) for each in (runner, without)]
        away.append(abs(_rho(pair[0], vd) - _rho(pair[1], vd)))
    return round(float(np.mean(away)), 5)


def _rho(trace: Trace, vd: float) -> float:
    return _spec().robustness(trace, {"vd": vd})["walking"]


@cache
def _spec() -> Spec:
    return load_spec(SPEC)


def chosen(rng: Generator, kind: CaseKind) -> list[Kind]:
    """Draw which effects a case has."""
    if kind == "null":
        return []
    if kind == "unknown":
        group = UNLIKE if rng.uniform() < 0.5 else NEAR
        return [group[int(rng.integers(len(group)))]]
    count = {"single": 1, "pair": 2, "triple": 3}[kind]
    names = rng.choice(sorted(KNOWN), count, replace=False)
    return [KNOWN[str(name)] for name in names]


def twin_of(
    kinds: list[Kind],
    size: Mapping[str, float],
    seed: int,
    background: float = BACKGROUND,
    without: Collection[str] = (),
) -> tuple[Twin, dict[str, dict[str, float]]]:
    """Return a robot with these sizes of effects, a little of every other one, and the label's values.

    Of the effects ``without`` there is nothing at all: the same robot with other ``kinds`` differs in these alone.
    """
    build, small = _drawn(seed, background, {*size, *without})
    twin = Twin(build=build)
    for kind, draws, values in small:
        kind.apply(twin, draws, values)
    effects = {}
    for kind in kinds:
        draws = np.random.default_rng([seed, 8, len(effects)])
        values = kind.values(draws, size[kind.name])
        kind.apply(twin, draws, values)
        effects[kind.name] = {name: round(float(value), 6) for name, value in values.items()}
    return twin, effects


def background_of(seed: int, without: Collection[str]) -> dict[str, dict[str, float]]:
    """Return effect → values of the little that a robot has of every effect but these."""
    _, small = _drawn(seed, BACKGROUND, without)
    return {
        kind.name: {name: round(float(value), 6) for name, value in values.items()}
        for kind, _, values in small
    }


def _drawn(
    seed: int, background: float, without: Collection[str]
) -> tuple[Build, list[tuple[Kind, Generator, Mapping[str, float]]]]:
    """Return how a robot is built, and every effect that it has a little of, with its random numbers and values."""
    rng = np.random.default_rng([seed, 7])
    build = made(rng) if background else Twin().build
    small = []
    for kind in KNOWN.values():
        amount, draws = background * kind.high * abs(rng.normal()), np.random.default_rng(rng.integers(2**62))
        if amount and kind.name not in without:
            small.append((kind, draws, kind.values(draws, amount)))
    return build, small


def tests(rng: Generator, budget: int) -> list[float]:
    """Return ``budget`` commands [m/s] evenly over the test space, a third of the tests three times, shuffled."""
    distinct = max(1, round(budget * 3 / 5))
    repeated = (budget - distinct) // 2
    single = stratified(rng, budget - 2 * repeated)
    again = rng.choice(len(single), repeated, replace=False)
    all_of_them = np.concatenate((single, np.repeat(np.array(single)[again], 2)))
    return [float(vd) for vd in rng.permutation(all_of_them)]


def stratified(rng: Generator, count: int) -> list[float]:
    """Return ``count`` commands [m/s], one uniform in each of as many equal parts of the test space."""
    low, high = RANGE
    parts = (np.arange(count) + rng.uniform(size=count)) / max(count, 1)
    return [float(vd) for vd in low + (high - low) * parts]


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(log(low), log(max(low, high)))))
