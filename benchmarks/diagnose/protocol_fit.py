"""First experiment of the second diagnosis: how well does one joint fit of trots and protocols measure every effect?

python -m benchmarks.diagnose.protocol_fit [--twins 40] [--practice 40] [--workers 2] [--write]

Data of a twin of the independent generator (``benchmarks/blind/a1``): two trots at each of three commands, and two runs
of each protocol. Unknown: θ (K,), every parameter of the catalogue in typical sizes, all of them at once. The model and
the estimator are those of ``s2r_spec.diagnose``: `inference/hierarchical.py` and `inference/gauss_newton.py`. Of the 21
effects every one can be a cause of a twin, and a little of each is in all of them.

It prints, over all twins and background included, the error of each parameter's estimate: rms, bias, slope of estimate
on truth, and the share of truths in the 90 % intervals. Parameters that only say how an effect acts are left out, such
as a payload's place.

Then it prints named effects against the truth by size, and the misfit of twins beyond the 95 % quantile of practice
machines. Those are the simulator itself with the same mix of effects. More than 15 % of such alarms would mean that
the laws differ too much.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import default_rng

from benchmarks.blind.a1.cases import background_of, twin_of
from benchmarks.blind.a1.effects import KNOWN
from benchmarks.blind.a1.protocols import Bench
from benchmarks.blind.a1.rollout import Runner
from benchmarks.rows import add_arguments, resumed
from s2r_spec.diagnose.data.rollouts import as_experiment
from s2r_spec.diagnose.data.space_filling import star
from s2r_spec.diagnose.estimation import Estimate, estimate
from s2r_spec.diagnose.inference.model_search import ModelPosterior
from s2r_spec.diagnose.inference.prior import LIKELY, NAMED, SURE, UNNAMED
from s2r_spec.diagnose.simulator.bench import Bench as SimulatorBench
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library
from s2r_spec.diagnose.simulator.response import ResponseLibrary
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace

RESULT = Path(__file__).parents[1] / "results" / "protocol_fit.json"
SPEC = load_spec(Path(__file__).parents[2] / "specs" / "a1_velocity.stl")
BENCH = SimulatorBench.of(SPEC, SPEC.requirements[0], "sim")
SIM = BENCH.backend
TROTS = tuple(as_experiment(BENCH, test) for test in star(SPEC.space))
"""Definition: trots at the middle command and at both ends, the tests that `s2r diagnose` has in its library."""
PROTOCOLS = tuple(Experiment(protocol.name) for protocol in SIM.protocols())
EXPERIMENTS = (*TROTS, *PROTOCOLS)
COUNTS = (1, 2, 1, 0)
"""Definition: number of causes of the machines in turn."""


@cache
def responses() -> ResponseLibrary:
    return library(SIM, EXPERIMENTS)


def machine(number: int, seed: int) -> tuple[Any, list[str], dict[str, Mapping[str, float]]]:
    """Return a generator's twin, its causes, and every value, the background's too."""
    rng = default_rng([seed, number])
    count = COUNTS[number % len(COUNTS)]
    causes = [str(name) for name in rng.choice(sorted(KNOWN), count, replace=False)]
    size = {}
    for name in causes:
        kind = KNOWN[name]
        most = max(kind.low, (1.0, 1.0, 0.8)[count] * kind.high)
        size[name] = float(np.exp(rng.uniform(np.log(kind.low), np.log(most))))
    own = int(rng.integers(2**62))
    twin, values = twin_of([KNOWN[name] for name in causes], size, own)
    return twin, causes, {**background_of(own, causes), **values}


def of_twin(job: tuple[int, int]) -> dict[str, Any]:
    number, seed = job
    twin, causes, values = machine(number, seed)
    runner, bench = Runner(twin), Bench(twin)
    traces: dict[Experiment, list[Trace]] = {}
    for place, experiment in enumerate(EXPERIMENTS):
        for k in range(2):
            rng = default_rng([seed, number, k, place])
            protocol = experiment.protocol
            trace = bench.run(protocol, rng) if protocol else runner.run(dict(experiment.params)["vd"], rng)
            traces.setdefault(experiment, []).append(trace)
    return row(number, causes, responses().coordinates(values), traces)


def of_practice(job: tuple[int, int]) -> dict[str, Any]:
    """Fit the simulator itself, with causes between a quarter and one typical size, and background."""
    number, seed = job
    rng = default_rng([seed, number, 1])
    parameters = responses().parameters
    low, high = responses_range()
    theta = np.clip(0.05 * rng.normal(size=len(parameters)), low, high)
    theta[[bool(p.base) for p in parameters]] = 0.0
    chosen = rng.choice(len(parameters), COUNTS[number % len(COUNTS)], replace=False)
    for k in chosen:
        size = rng.uniform(NAMED, 1.0)
        theta[k] = size if high[k] > 1e-9 and (low[k] > -1e-9 or rng.uniform() < 0.5) else -size
    theta = np.clip(theta, low, high)
    backend = SIM.with_effects(responses().values(theta))
    first = int(rng.integers(10**6)) + 10_000
    traces = {e: [e.run(backend, first + k) for k in range(2)] for e in EXPERIMENTS}
    return row(number, [parameters[k].name for k in chosen], theta, traces)


def responses_range() -> tuple[np.ndarray, np.ndarray]:
    ends = np.array([[p.coordinate(p.low), p.coordinate(p.high)] for p in responses().parameters])
    return ends.min(axis=1), ends.max(axis=1)


def row(
    number: int, causes: list[str], truth: np.ndarray, traces: Mapping[Experiment, Sequence[Trace]]
) -> dict[str, Any]:
    began = time.process_time()
    found = estimate(SIM, responses(), traces)
    seconds = time.process_time() - began
    low, high = (found.posterior.quantile(level) for level in (0.05, 0.95))
    return {
        "number": number,
        "causes": causes,
        "truth": truth.tolist(),
        "estimate": found.fit.theta.tolist(),
        "median": found.posterior.quantile(0.5).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "named": is_named(found.posterior).tolist(),
        "misfit": misfit(found),
        "seconds": seconds,
    }


def is_named(posterior: ModelPosterior) -> np.ndarray:
    """Return (E,) whether each effect is named, as in an answer."""
    return (posterior.beyond(UNNAMED) >= SURE) & (posterior.beyond(NAMED) >= LIKELY)


def misfit(found: Estimate) -> dict[str, float]:
    """Return experiment → mean logarithm of the energy that the fit leaves in each group."""
    theta, problem = found.fit.theta, found.problem
    energies = {
        str(one.response.experiment): one.groups(theta, errors).energy
        for one, errors in zip(problem.observations, problem.errors(theta), strict=True)
        if one.parts
    }
    return {name: float(np.mean(np.log(energy + 1e-9))) for name, energy in energies.items()}


def errors(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Return parameter → error of the estimates over all machines, in typical sizes."""
    truth, found, low, high = (
        np.array([row[key] for row in rows]) for key in ("truth", "median", "low", "high")
    )
    table = {}
    for k, parameter in enumerate(responses().parameters):
        t, e = truth[:, k], found[:, k]
        if parameter.base:
            continue
        table[parameter.name] = {
            "rms": float(np.sqrt(np.mean((e - t) ** 2))),
            "bias": float(np.mean(e - t)),
            "slope": float(t @ e / (t @ t)) if t.any() else float("nan"),
            "always zero": float(np.sqrt(np.mean(t**2))),
            "in the interval": float(np.mean((low[:, k] <= t) & (t <= high[:, k]))),
        }
    return table


def verdicts(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return the share of machines whose named effects are right by size, and how many effects are missed or wrong."""
    parameters = responses().parameters
    effects = list(dict.fromkeys(p.effect for p in parameters))
    right, missed, wrong = [], 0, 0
    for one in rows:
        size = {
            effect: max(
                abs(t)
                for p, t in zip(parameters, one["truth"], strict=True)
                if p.effect == effect and not p.base
            )
            for effect in effects
        }
        answer = {effect for effect, is_asserted in zip(effects, one["named"], strict=True) if is_asserted}
        lost = {effect for effect in effects if size[effect] >= NAMED} - answer
        extra = {effect for effect in answer if size[effect] < UNNAMED}
        right.append(not lost and not extra)
        missed, wrong = missed + len(lost), wrong + len(extra)
        one["lost"], one["extra"] = sorted(lost), sorted(extra)
    return {"exact sets": float(np.mean(right)), "missed effects": missed, "wrong effects": wrong}


def show(title: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    table, verdict = errors(rows), verdicts(rows)
    rms = [one["rms"] for one in table.values()]
    inside = np.mean([one["in the interval"] for one in table.values()])
    print(f"\n{title}: {len(rows)} machines; median rms error {np.median(rms):.3f} of typical")
    print(f"parameters above 0.08: {sum(one > 0.08 for one in rms)}; truths in 90 % intervals: {inside:.2f}")
    for name, one in sorted(table.items(), key=lambda item: -item[1]["rms"]):
        print("  ", f"{name:28}", "  ".join(f"{key} {value:+.3f}" for key, value in one.items()))
    print("named by size:", verdict)
    for one in rows:
        if one["lost"] or one["extra"]:
            print("  ", one["number"], one["causes"], "missed", one["lost"], "wrong", one["extra"])
    return {
        "errors": table,
        "verdicts": verdict,
        "median rms": float(np.median(rms)),
        "coverage": float(inside),
    }


def jobs(kind: str, count: int, seed: int) -> dict[str, tuple[int, int]]:
    """Return name of the row → number and seed of each machine."""
    return {f"{kind}-{seed}-{number:02d}": (number, seed) for number in range(count)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twins", type=int, default=40)
    parser.add_argument("--practice", type=int, default=40)
    parser.add_argument("--seed", type=int, default=46)
    add_arguments(parser)
    given = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    began = time.time()
    library(SIM, EXPERIMENTS, partial(ProcessPoolExecutor, given.workers))
    print(f"library: {time.time() - began:.0f} s on {given.workers} cores", flush=True)
    with ProcessPoolExecutor(given.workers) as pool:
        twins = []
        for one in resumed(of_twin, jobs("twin", given.twins, given.seed), pool, given.rows):
            twins.append(one)
            print(one["number"], one["causes"], f"{one['seconds']:.0f} s", flush=True)
        result: dict[str, Any] = {"twins": show("twins of the generator", twins)}
        practice = list(resumed(of_practice, jobs("practice", given.practice, given.seed), pool, given.rows))
    if practice:
        result["practice"] = show("practice machines", practice)
        for experiment in map(str, EXPERIMENTS):
            level = float(np.quantile([one["misfit"].get(experiment, -9.0) for one in practice], 0.95))
            alarms = float(np.mean([one["misfit"].get(experiment, -9.0) > level for one in twins]))
            result.setdefault("alarms", {})[experiment] = alarms
            print(
                f"misfit of {experiment}: {100 * alarms:.0f} % of the twins beyond the practice machines' 95 %"
            )
    result["seconds"] = float(np.median([one["seconds"] for one in twins]))
    print(f"seconds of processor a fit, median: {result['seconds']:.1f}")
    if given.write:
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
