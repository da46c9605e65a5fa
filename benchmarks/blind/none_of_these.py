"""How often is a machine none of these? Healthy ones, ones with a known effect, and ones with an unknown effect.

python -m benchmarks.blind.none_of_these [--machines 20] [--seed 7] [--write]        # 4 s a machine on one core

Data of each machine (``benchmarks/blind/car``, ``quad`` and ``segway``, by other authors than the simulators): two runs
of three tests of the specification and of every protocol. The number of a machine says its kind: healthy, one effect of
the catalogue, or one effect outside it. Sizes are from half to one and a half of typical. All have a little of
everything. Printed are the alarms of :mod:`s2r_spec.diagnose.inference.goodness_of_fit` at its level.

Machines of seed 7 chose among its statistics, so they are validation. Other seeds chose nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from benchmarks.blind.outsiders.cases import background, chosen, size_of, stratified  # noqa: E402
from benchmarks.blind.outsiders.lab import Lab  # noqa: E402
from benchmarks.machine import describe  # noqa: E402
from s2r_spec.backend import load_backend  # noqa: E402
from s2r_spec.diagnose.estimation import Estimate, estimate  # noqa: E402
from s2r_spec.diagnose.inference.goodness_of_fit import LEVEL, goodness_of_fit  # noqa: E402
from s2r_spec.diagnose.simulator.experiments import Experiment  # noqa: E402
from s2r_spec.diagnose.simulator.library import ResponseLibrary, library  # noqa: E402
from s2r_spec.spec import load_spec  # noqa: E402
from s2r_spec.trace import Trace  # noqa: E402

RESULT = ROOT / "benchmarks" / "results" / "none_of_these.json"
ROBOTS = ("car", "quad", "segway")
KINDS = ("null", "single", "unknown")
TESTS, RUNS = 3, 2
"""Budgets: tests of the specification, and runs of every experiment."""


@cache
def responses(robot: str) -> tuple[Any, ResponseLibrary]:
    """Return a simulator and its responses to some tests and to every protocol."""
    sys.path.insert(0, str(ROOT / "benchmarks" / "blind" / robot / "simulator"))
    backend: Any = load_backend(robot)
    spec = load_spec(import_module(f"benchmarks.blind.{robot}.machine").SPEC)
    tests = [Experiment.test(test) for test in stratified(spec, np.random.default_rng(1), TESTS)]
    return backend, library(backend, [*tests, *(Experiment(p.name) for p in backend.protocols())])


def machine(robot: str, number: int, seed: int) -> tuple[list[str], dict[Experiment, list[Trace]]]:
    """Return the causes of a machine, and its runs."""
    real: Any = import_module(f"benchmarks.blind.{robot}.machine")
    protocols: Any = import_module(f"benchmarks.blind.{robot}.protocols")
    rng = np.random.default_rng([seed, number])
    causes = chosen(real, rng, KINDS[number % 3])
    values = background(real, rng, causes) | {cause.name: cause.made(size_of(cause, rng)) for cause in causes}
    traces: dict[Experiment, list[Trace]] = {}
    for experiment in (each.experiment for each in responses(robot)[1].responses):
        for _ in range(RUNS):
            if experiment.protocol:
                trace = Lab(protocols, values).run(experiment.protocol, {}, int(rng.integers(2**31)))
            else:
                trace = real.drive(values, dict(experiment.params), real.drawn_nuisance(rng))
            traces.setdefault(experiment, []).append(trace)
    return [cause.name for cause in causes], traces


def row(found: Estimate, causes: list[str]) -> dict[str, Any]:
    """Return the goodness of fit of a machine, and where its misfit is."""
    begun = time.process_time()
    goodness = goodness_of_fit(found.problem, found.fit)
    took, worst = time.process_time() - begun, goodness.worst
    place = (
        f"{worst.quantity} ({worst.statistic}) of {worst.experiment}, {worst.begin:.1f} to {worst.end:.1f} s"
    )
    effects = [found.library.parameters[k].effect for k in found.posterior.sets[0]]
    return {
        "causes": causes,
        "set": effects,
        "p": goodness.p,
        "alarm": goodness.alarm,
        "worst": place,
        "s": took,
    }


def scores(rows: dict[str, dict[str, list[dict[str, Any]]]]) -> dict[str, Any]:
    """Return alarms and machines of every kind, by robot and in all; of unknown effects by cause, too."""
    every = {kind: [one for robot in rows.values() for one in robot.get(kind, [])] for kind in KINDS}
    count = {
        name: {kind: f"{sum(one['alarm'] for one in found)} of {len(found)}" for kind, found in kinds.items()}
        for name, kinds in {**rows, "all": every}.items()
    }
    causes: dict[str, list[bool]] = {}
    for robot, kinds in rows.items():
        for one in kinds.get("unknown", []):
            causes.setdefault(f"{robot}: {one['causes'][0]}", []).append(one["alarm"])
    by_cause = {name: f"{sum(alarms)} of {len(alarms)}" for name, alarms in sorted(causes.items())}
    took = [one["s"] for found in every.values() for one in found]
    return {"alarms": count, "unknown effects": by_cause, "longest test [s of one core]": round(max(took), 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=20, help="of each robot and kind")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--write", action="store_true", help=f"write {RESULT.relative_to(ROOT)}")
    arguments = parser.parse_args()
    rows: dict[str, dict[str, list[dict[str, Any]]]] = {robot: {} for robot in ROBOTS}
    for number in range(3 * arguments.machines):
        for robot in ROBOTS:
            backend, known = responses(robot)
            causes, traces = machine(robot, number, arguments.seed)
            one = row(estimate(backend, known, traces), causes)
            rows[robot].setdefault(KINDS[number % 3], []).append(one)
            print(robot, KINDS[number % 3], *causes, f"p = {one['p']:.3f}: {one['worst']}", file=sys.stderr)
        if arguments.write and number % 3 == 2:
            write(arguments.seed, rows)
    print(json.dumps(scores(rows), indent=2))


def write(seed: int, rows: dict[str, dict[str, list[dict[str, Any]]]]) -> None:
    """Write the machines of a seed so far beside those of other seeds."""
    kept = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    found = {"computer": describe("numpy"), "level": LEVEL, **scores(rows), "machines": rows}
    RESULT.write_text(json.dumps({**kept, f"seed {seed}": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
