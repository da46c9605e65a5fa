"""What simpler methods name on the sealed sets that are open: their rates beside those of the diagnosis.

    python -m benchmarks.blind.baselines --folder FOLDER turtlebot emps … [--write]      # FOLDER is that of `check`

All have the tests and the response library of the diagnosis, and σ of the scatter of the simulator's runs:

    joint      least squares of all sizes at once; the effect of the largest size is named
    single     least squares of one effect alone; the effect that leaves the least is named
    rho        as *single*, but from the mean ρ of each test alone, linear in the size

Each names an effect of at least a quarter of typical. Sizes are in typical sizes, within the ranges of the catalogue.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.blind.check import RESULTS, SETS
from benchmarks.blind.development import axes, simulator
from benchmarks.blind.scoring import MUST, Scored
from s2r_spec.backend import load_backend
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.data.rollouts import RealRollouts, as_experiment, recorded_rollouts
from s2r_spec.diagnose.data.space_filling import representative
from s2r_spec.diagnose.data.split import split
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.library import library
from s2r_spec.diagnose.simulator.response import ResponseLibrary
from s2r_spec.space import key_of
from s2r_spec.spec import load_spec

METHODS = ("joint", "single", "rho")
SEEDS = range(5)
"""Budget: runs of the simulator whose mean ρ stands for a test."""

RhoTable = dict[tuple[Any, str], float]


@dataclass(frozen=True)
class Data:
    """Real tests beside the simulator.

    Attributes:
        bench: the simulator.
        train: the real tests that a diagnosis estimates sizes from.
        responses: the library of these tests.
        observations: of these tests.
    """

    bench: Bench
    train: RealRollouts
    responses: ResponseLibrary
    observations: tuple[Observation, ...]

    @classmethod
    def of(cls, case: Path, machine: str, cache: Cache) -> Data:
        """Return those of a folder of logs."""
        spec = load_spec(case / "spec.stl")
        bench = Bench.of(spec, spec.requirements[0], load_backend(simulator(machine)))
        real = recorded_rollouts(bench, load_backend(f"log:{case}"), passive=True)
        train = split(real, 0).train
        tests = representative([test for test, _ in train.tests], spec.space)
        responses = library(bench.backend, [as_experiment(bench, test) for test in tests], cache=cache)
        runs = {e: r for e, r in train.by_experiment(bench).items() if e in responses.experiments}
        observations = []
        for experiment, traces in runs.items():
            own = responses.response(experiment)
            vectors = [
                own.observables.vector(experiment.with_residuals(trace, bench.backend)) for trace in traces
            ]
            observations.append(Observation.of(own, vectors, responses.dependence))
        return cls(bench, train, responses, tuple(one for one in observations if one.parts))

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """(K,) low and high ends of all sizes."""
        low, high = np.array([axis.ends for axis in self.responses.parameters]).T
        return low - 1e-9, high + 1e-9

    def fitted(self, free: Sequence[int]) -> tuple[FloatArray, float]:
        """Return (K,) the sizes by least squares, with those of ``free`` alone, and half the sum of squares."""
        low, high = (end[list(free)] for end in self.ends)
        theta = np.zeros(len(self.responses.parameters))

        def sizes(x: FloatArray) -> FloatArray:
            theta[list(free)] = x
            return theta

        def residual(x: FloatArray) -> FloatArray:
            return np.concatenate(
                [one.residual(sizes(x)) / np.sqrt(one.noise + 1e-12) for one in self.observations]
            )

        def slopes(x: FloatArray) -> FloatArray:
            columns = [
                -one.columns(sizes(x))[list(free)] / np.sqrt(one.noise + 1e-12) for one in self.observations
            ]
            return np.concatenate(columns, axis=1).T

        found = least_squares(residual, np.zeros(len(free)), slopes, bounds=(low, high), max_nfev=30)
        return sizes(found.x).copy(), float(found.cost)

    def members(self) -> dict[int, list[int]]:
        """Return parameter that acts alone → it and its dependents."""
        base = self.responses.dependence.base
        return {k: [k, *np.flatnonzero(base == k).tolist()] for k in np.flatnonzero(base < 0).tolist()}

    def joint(self) -> int | None:
        """Return the parameter of the largest size in a fit of all, if it is large."""
        theta, _ = self.fitted(range(len(self.responses.parameters)))
        size = np.where(self.responses.dependence.base < 0, np.abs(theta), 0.0)
        return int(np.argmax(size)) if size.max() >= MUST else None

    def single(self) -> int | None:
        """Return the parameter that alone leaves the least, if its size is large."""
        fits = {k: self.fitted(own) for k, own in self.members().items()}
        best = min(fits, key=lambda k: fits[k][1])
        return best if abs(fits[best][0][best]) >= MUST else None

    def rho(self, known: RhoTable) -> int | None:
        """Return the parameter whose change of ρ is nearest to the gaps of the tests, if its size is large."""
        real: dict[Any, list[float]] = {}
        tests = {key_of(test): test for test, _ in self.train.tests}
        for test, trace in self.train.tests:
            real.setdefault(key_of(test), []).append(self.bench.rho(trace, test))
        gap = np.array([np.mean(own) - self.simulated(known, "", tests[key]) for key, own in real.items()])
        left: dict[int, tuple[float, float]] = {}
        for k in self.members():
            axis = self.responses.parameters[k]
            change = np.array(
                [
                    self.simulated(known, axis.name, test) - self.simulated(known, "", test)
                    for test in tests.values()
                ]
            )
            scale = float(axis.coordinate(axis.at_typical()))
            low, high = (end[k] / scale for end in self.ends)
            x = np.clip(change @ gap / max(change @ change, 1e-12), min(low, high), max(low, high))
            left[k] = float(((gap - x * change) ** 2).sum()), float(x * scale)
        best = min(left, key=lambda k: left[k][0])
        return best if abs(left[best][1]) >= MUST else None

    def simulated(self, known: RhoTable, name: str, test: Mapping[str, float]) -> float:
        """Return the mean ρ of a test with an effect of typical size, or without a name the nominal one."""
        if (key := (key_of(test), name)) not in known:
            axis = next((axis for axis in self.responses.parameters if axis.name == name), None)
            values = axis.at(axis.at_typical()) if axis else {}
            runs = [self.bench.run(values, test, seed) for seed in SEEDS]
            known[key] = float(np.mean([self.bench.rho(run, test) for run in runs]))
        return known[key]


def named(case: Path, machine: str, cache: Cache, known: RhoTable) -> dict[str, list[str]]:
    """Return method → effects that it names."""
    data = Data.of(case, machine, cache)
    found = {"joint": data.joint(), "single": data.single(), "rho": data.rho(known)}
    return {method: [] if k is None else [data.responses.parameters[k].effect] for method, k in found.items()}


def rates(cases: Sequence[Scored]) -> dict[str, str]:
    """Return the rates of names; a method that names nothing has found no gap."""
    large = [
        effect in one.named
        for one in cases
        if one.kind != "unknown"
        for effect, size in one.sizes.items()
        if abs(size) >= MUST
    ]
    return {
        "must be named, and are": f"{sum(large)} of {len(large)}",
        "machines with a false name": f"{sum(bool(one.false) for one in cases)} of {len(cases)}",
    }


def main() -> None:
    """Print the rates of every method on every set."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="+", choices=tuple(SETS))
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument(
        "--write", action="store_true", help="keep the rates of these sets in results/baselines.json"
    )
    given = parser.parse_args()
    table: dict[str, dict[str, dict[str, str]]] = {}
    for name in given.sets:
        machine, known = {"emps": "axis"}.get(name, name), RhoTable()
        labels = json.loads((given.folder / f"{name}-answers" / "opened.json").read_text())["labels"]
        cases: dict[str, list[Scored]] = {method: [] for method in METHODS}
        for case, label in labels.items():
            for method, effects in named(
                given.folder / name / "public" / case, machine, Cache.usual(), known
            ).items():
                answer = {"verdict": "", "which": {"answer": effects}}
                cases[method].append(Scored(case, label, answer, axes(machine)))
        table[name] = {method: rates(own) for method, own in cases.items()}
        print(name, json.dumps(table[name], indent=1), flush=True)
    if given.write:
        path = RESULTS / "baselines.json"
        before = json.loads(path.read_text()) if path.exists() else {}
        path.write_text(json.dumps(before | table, indent=1) + "\n")


if __name__ == "__main__":
    main()
