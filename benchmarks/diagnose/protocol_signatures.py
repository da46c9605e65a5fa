"""Which effect does each protocol show? Signatures of every effect at a quarter of typical, of five machines.

python -m benchmarks.diagnose.protocol_signatures [--write]        # minutes on one core

Data: Y (2R, T, C), 2R = 48 runs of one protocol, or of one test of the spec, of the nominal machine, T samples of C
channels; and D (T, C), the mean change by one effect over four of the same seeds.
Model: y = ȳ + D + ε of one run, ε_t = A ε_{t−1} + e_t, e_t ~ N(0, S), and beside it what differs from run to run as a
whole, such as a start or a gain. A and S (C, C) are the least-squares estimates from the first R runs (Ljung, System
Identification, 1999, §10.3). The whitened samples z of these runs, Z (R, n), give the covariance I + ZᵀZ / R.
Estimator: d is the whitened D, and the filter is w = (I + ZᵀZ / R)⁻¹ d. One run shows the effect by wᵀd / sd(wᵀz)
standard deviations. sd(wᵀz) is that of the other R runs, which need not obey the model, so its relative error is 15 %.
A better model of the noise would give a better filter, so the figure is a lower bound.

Two effects: D is the difference of both changes. *Any size* subtracts the multiple of the second change that comes
nearest to the first, so the rest separates them whatever the second effect's size is.

Units: σ of one run. Typical is twice the standard deviation of the prior, and at most the range.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.outsiders.cases import stratified
from benchmarks.blind.outsiders.lab import Lab
from benchmarks.machine import describe
from s2r_spec.backend import EffectParameter, load_backend
from s2r_spec.effects import prior_scale
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace

ROOT = Path(__file__).parents[2]

RESULT = ROOT / "benchmarks" / "results" / "protocol_signatures.txt"
OUTSIDERS = ("quad", "car", "arm", "segway")
RUNS, SAME, TESTS, QUARTER = 24, 4, 6, 0.25
"""Budgets: R, seeds of a change, tests of the spec. Definition: the size of an effect, of typical."""
FLOOR = 1e-3
"""Tolerance: share of the mean variance that every direction of the innovations has at least. Without it a channel that
follows from others would count as known exactly. With twice as much, figures of effects that break such a relation
(speed_filter, damping_gain) halve, and few others change by more than a tenth."""
PAIRS = (
    ("quad", "rotor_lag", {"time": 0.008}, "command_delay", {"time": 0.008}),
    ("quad", "rotor_lag", {"time": 0.016}, "command_delay", {"time": 0.016}),
    ("axis", "current_lag", {"time": 0.001}, "delay", {"time": 0.001}),
    ("car", "steer_lag", {"time": 0.03}, "steer_delay", {"time": 0.03}),
)
"""Effects that tests of the spec confuse: a lag and a delay of the same time."""
STRANGERS = (
    ("quad", "weak_rear_rotor", "com_offset"),
    ("car", "steering_play", "steer_lag"),
    ("car", "steering_play", "steer_delay"),
)
"""Effects outside the catalogue, of the independent machine, and the member that imitates each."""

Array = NDArray[np.float64]
Play = Callable[[str, Any, int], Trace]
"""(protocol or number of a test, effects, seed) → trace."""


@dataclass(frozen=True, eq=False)
class Bench:
    """A machine with its effects at a size, and what it can run: protocols by name, and the spec's tests by number."""

    play: Play
    experiments: tuple[str, ...]
    effects: dict[str, Any]
    nothing: Any

    def change(self, experiment: str, effects: Any) -> Array:
        """Return (T, C) by how much these effects change each sample, to the end of the shortest run."""
        changes = [
            (rows(self.play(experiment, effects, seed)), rows(self.play(experiment, self.nothing, seed)))
            for seed in range(SAME)
        ]
        end = min(len(one) for one, _ in changes)
        return np.mean([one[:end] - base[:end] for one, base in changes], axis=0)

    def sigma(self, experiment: str, change: Array) -> float:
        """Return by how many standard deviations of one run a change shows."""
        errors, whitening = noise(self, experiment)
        signal = whitening(change).ravel()
        if not np.any(signal):
            return 0.0
        first, second = np.split(whitening(errors[:, : len(change)]).reshape(2 * RUNS, -1), 2)
        weights = signal - first.T @ np.linalg.solve(RUNS * np.eye(RUNS) + first @ first.T, first @ signal)
        return float(weights @ signal / (second @ weights).std(ddof=1))

    def apart(self, experiment: str, one: Any, other: Any) -> tuple[float, float]:
        """Return by how many σ two effects differ, and by how many if the second may have any size."""
        first, second = self.change(experiment, one), self.change(experiment, other)
        end = min(len(first), len(second))
        first, second = first[:end], second[:end]
        _, whitening = noise(self, experiment)
        a, b = whitening(first).ravel(), whitening(second).ravel()
        return self.sigma(experiment, first - second), self.sigma(
            experiment, first - (a @ b) / (b @ b) * second
        )


@dataclass(frozen=True, eq=False)
class Whitening:
    """The map from samples to innovations of unit variance.

    Attributes:
        used: (C,) whether a channel has noise.
        scale: (U,) its standard deviation, of the U used channels.
        past: (U, U) A, in units of ``scale``.
        inverse_root: (U, U) S^{-1/2}.
    """

    used: NDArray[np.bool_]
    scale: Array
    past: Array
    inverse_root: Array

    @classmethod
    def of(cls, errors: Array) -> Whitening:
        """Estimate it from (R, T, C) errors."""
        spread = errors.std(axis=(0, 1))
        used = spread > 0.0
        scaled = errors[..., used] / spread[used]
        before, now = (part.reshape(-1, used.sum()) for part in (scaled[:, :-1], scaled[:, 1:]))
        past = np.linalg.lstsq(before, now, rcond=1e-6)[0].T
        values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(now - before @ past.T, rowvar=False)))
        inverse_root = (vectors / np.sqrt(values + FLOOR * values.mean())) @ vectors.T
        return cls(used, spread[used], past, inverse_root)

    def __call__(self, samples: Array) -> Array:
        """Return (…, T − 1, U) innovations of (…, T, C) samples."""
        scaled = samples[..., self.used] / self.scale
        return (scaled[..., 1:, :] - scaled[..., :-1, :] @ self.past.T) @ self.inverse_root


@cache
def noise(bench: Bench, experiment: str) -> tuple[Array, Whitening]:
    """Return (2R, T, C) of nominal runs without their mean, and the whitening of the first half's noise."""
    runs = np.stack([rows(bench.play(experiment, bench.nothing, seed)) for seed in range(2 * RUNS)])
    halves = [half - half.mean(axis=0) for half in np.split(runs, 2)]
    return np.concatenate(halves), Whitening.of(halves[0])


def rows(trace: Trace) -> Array:
    """Return (T, C) all channels of a trace side by side."""
    return np.hstack([np.reshape(values, (len(trace), -1)) for values in trace.channels.values()])


def typical(parameter: EffectParameter) -> float:
    """Return the typical distance from nominal, towards the farther end of the range."""
    up = parameter.high - parameter.nominal >= parameter.nominal - parameter.low
    reach = parameter.high - parameter.nominal if up else parameter.low - parameter.nominal
    size = 2.0 * prior_scale(parameter)
    return float(np.copysign(min(size, abs(reach)) if size else abs(reach), reach))


@cache
def tests_of(path: Path) -> list[dict[str, float]]:
    return stratified(load_spec(path), np.random.default_rng(1), TESTS)


@cache
def simulator(machine: str) -> Bench:
    """Return the simulator of a machine."""
    if machine in OUTSIDERS:
        sys.path.insert(0, str(ROOT / "benchmarks" / "blind" / machine / "simulator"))
        spec = import_module(f"benchmarks.blind.{machine}.machine").SPEC
    else:
        spec = ROOT / "specs" / "emps_tracking.stl"
    backend: Any = load_backend({"axis": "emps"}.get(machine, machine))
    protocols = [protocol.name for protocol in backend.protocols()]

    def play(experiment: str, values: Any, seed: int) -> Trace:
        nominal = backend.with_effects(values) if values else backend
        if experiment in protocols:
            return nominal.run(experiment, {}, seed)
        return nominal.rollout(tests_of(spec)[int(experiment)], seed)

    effects = {
        effect.name: {effect.name: {p.name: p.nominal + QUARTER * typical(p)}}
        for effect in backend.effects()
        for p in effect.parameters[:1]
    }
    return Bench(play, (*map(str, range(TESTS)), *protocols), effects, {})


@cache
def independent(machine: str) -> Bench:
    """Return the independent machine, with unknown effects beside those of the catalogue."""
    real: Any = import_module(f"benchmarks.blind.{machine}.machine")
    protocols: Any = import_module(f"benchmarks.blind.{machine}.protocols")
    names = [protocol.name for protocol in protocols.PROTOCOLS]

    def play(experiment: str, values: Any, seed: int) -> Trace:
        if experiment in names:
            return Lab(protocols, values).run(experiment, {}, seed)
        nuisance = real.drawn_nuisance(np.random.default_rng(seed))
        return real.drive(values, tests_of(real.SPEC)[int(experiment)], nuisance)

    effects = {cause.name: {cause.name: cause.made(QUARTER)} for cause in (*real.KNOWN, *real.UNKNOWN)}
    return Bench(play, (*map(str, range(TESTS)), *names), effects, {})


def table(bench: Bench, title: str) -> str:
    """Return the signatures of all effects; of the spec's tests the best one."""
    protocols = bench.experiments[TESTS:]
    lines = [title, f"{'':22}{'best test':>15}" + "".join(f"{name:>15}" for name in protocols)]
    for name, values in bench.effects.items():
        found = [bench.sigma(each, bench.change(each, values)) for each in bench.experiments]
        row = [max(found[:TESTS]), *found[TESTS:]]
        lines.append(f"{name:22}" + "".join(f"{value:15.1f}" for value in row))
    return "\n".join(lines)


def pair(bench: Bench, title: str, one: Any, other: Any) -> str:
    """Return how far two effects are apart in every protocol, and in the best test."""
    found = {name: bench.apart(name, one, other) for name in bench.experiments}
    rows = {"best test": tuple(max(found[str(k)][j] for k in range(TESTS)) for j in (0, 1))}
    rows |= {name: found[name] for name in bench.experiments[TESTS:]}
    lines = [title, f"{'':22}{'as stated':>15}{'any size':>15}"]
    return "\n".join(
        [*lines, *(f"{name:22}{given:15.1f}{free:15.1f}" for name, (given, free) in rows.items())]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {RESULT.relative_to(ROOT)}")
    arguments = parser.parse_args()
    parts = ["Signatures at a quarter of typical, in standard deviations of one run."]
    for machine in ("axis", *OUTSIDERS):
        parts.append(table(simulator(machine), f"{machine}: simulator"))
        if machine in OUTSIDERS:
            parts.append(table(independent(machine), f"{machine}: independent machine"))
    for machine, one, first, other, second in PAIRS:
        words = f"{one} against {other}, {next(iter(first.values())):g} s each"
        parts.append(
            pair(simulator(machine), f"{machine}: simulator, {words}", {one: first}, {other: second})
        )
        if machine in OUTSIDERS:
            plain = [{name: next(iter(v.values()))} for name, v in ((one, first), (other, second))]
            parts.append(pair(independent(machine), f"{machine}: independent machine, {words}", *plain))
    for machine, one, other in STRANGERS:
        bench = independent(machine)
        words = f"{machine}: independent machine, {one} against {other}, a quarter of typical each"
        parts.append(pair(bench, words, bench.effects[one], bench.effects[other]))
    text = "\n\n".join(parts) + "\n"
    print(text, end="")
    if arguments.write:
        machine_of = describe("numpy")
        RESULT.write_text(
            f"$ python -m benchmarks.diagnose.protocol_signatures --write\n{machine_of}\n{text}"
        )


if __name__ == "__main__":
    main()
