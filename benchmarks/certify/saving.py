"""How many rollouts of a machine does a certificate take, before and after its cause is in the simulator?

Ten twins, each with one effect of random kind and size, that stand in for a machine. For each: a diagnosis from 24 of
its rollouts, and then a pilot and a certificate that stops at its verdict, in four ways:

    one B    the simulator; the gap has B and epsilon of the check, or those that the pilot proposes if these are larger
    gap_B    the simulator; the pilot's own gap_B, gap_R and gap_epsilon
    patched  the simulator with the effect that the diagnosis names (``s2r diagnose --apply``); its own pilot and line
    patched, short pilot   the same with 20 real rollouts in the pilot

An interval is right if 300 other rollouts of the twin, at the tests of a grid and at its own worst test, agree
with it. Then 1,000 searches on random functions, from the pilot's outcomes to the verdict, whose truth is known
exactly. ::

    OMP_NUM_THREADS=1 python -m benchmarks.certify.saving           # half an hour of two cores
    OMP_NUM_THREADS=1 python -m benchmarks.certify.saving --write   # and keep the result
"""

from __future__ import annotations

import argparse
import math
import signal
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import s2r_spec as s2r
from benchmarks.certify.pilot import document
from benchmarks.machine import describe
from s2r_spec.backend import Backend, HasEffects
from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.from_spec import of_gap
from s2r_spec.certify.pilot.design import REPLICATES, design
from s2r_spec.certify.pilot.proposal import Evidence, Outcomes, propose
from s2r_spec.certify.pilot.run import pilot
from s2r_spec.certify.pilot.surface import FAMILIES
from s2r_spec.certify.result.compose import decides, judge
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.search.search import Search
from s2r_spec.lang.certify_line import certify_line, with_certify_line
from s2r_spec.runs.scorer import Scorer
from s2r_spec.space import Space
from s2r_spec.spec import CertifySettings, Spec, load_spec, parse_spec
from s2r_spec.workers.pools import in_this_process

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "certify_saving.json"
SPECS = {"turtlebot": "specs/turtlebot.stl", "emps": "specs/emps_tracking.stl"}
TWINS = 5
"""Twins of each simulator."""
ROLLOUTS, TRUTH, SIDES = 24, 300, {2: 5, 3: 3}
"""Rollouts of a diagnosis and of the truth; tests on each axis of the truth's grid."""
LOW, HIGH = 0.4, 0.9
"""Size of an effect, as a part of the way to the end of its range."""
WAYS = {"one B": None, "gap_B": None, "patched": None, "patched, short pilot": 20}
"""Way to a certificate → real rollouts of its pilot; None for the usual grid."""
BUDGET = 1000
"""Most real rollouts of a certificate."""
LIMIT = 300.0
"""Budget: processor time of a certificate [s]; the simulator's search has no budget of its own."""
RUNS, NOISE = 1000, 0.01
"""Random functions, and the deviation of a rollout's ρ."""


def effect_of(backend: HasEffects, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Return one effect of a simulator, of random kind and size."""
    effect = rng.choice(np.array(backend.effects(), dtype=object))
    parameter = effect.parameters[0]
    ends = [end for end in (parameter.low, parameter.high) if end != parameter.nominal]
    value = parameter.nominal + rng.uniform(LOW, HIGH) * (rng.choice(ends) - parameter.nominal)
    return {effect.name: {parameter.name: float(value)}}


def worst_mean(spec: Spec, backend: Backend, worst: dict[str, float]) -> tuple[float, float]:
    """Return the lowest mean ρ over the tests of a grid and one other test, and its standard error."""
    scorer = Scorer.for_spec(spec, next(iter(spec.requirements)), backend)
    grid = spec.space.grid((SIDES[spec.space.dim],) * spec.space.dim)
    tests = [worst, *map(spec.space.point, grid)]
    count, found = TRUTH // len(tests), []
    for i, test in enumerate(tests):
        traces = [
            scorer.backend.rollout(scorer.to_backend(test), 10_000 + count * i + k) for k in range(count)
        ]
        rhos = [scorer.fall if trace.failure else scorer.measure(trace, test) for trace in traces]
        found.append((float(np.mean(rhos)), float(np.std(rhos, ddof=1)) / math.sqrt(count)))
    return min(found)


def twin(job: tuple[str, int]) -> list[dict[str, Any]]:
    """Diagnose and certify one twin; return a row for each way."""
    name, seed = job
    rng = np.random.default_rng([seed, *name.encode()])
    path, nominal = ROOT / SPECS[name], s2r.load_backend(name)
    effect = effect_of(nominal, rng)
    machine, spec = nominal.with_effects(effect), load_spec(path)
    points = spec.space.at(rng.uniform(size=(ROLLOUTS, spec.space.dim)))
    with tempfile.TemporaryDirectory() as folder:
        rollouts = [
            (test, machine.rollout(test, 700 + i)) for i, test in enumerate(map(spec.space.point, points))
        ]
        found = s2r.diagnose(spec, nominal, rollouts, cache=Path(folder) / "cache", where=False)
        patched = found.improved(False)
        better = nominal.with_effects(patched) if patched else nominal
        rows = []
        for way, budget in WAYS.items():
            if way == "patched" and not patched:
                row = rows[-1] | {"way": way}
            else:
                row = certified(path, better if "patched" in way else nominal, machine, way, seed, budget)
            rows.append({"twin": f"{name} {seed}", "has": effect, "added": patched} | row)
            print(rows[-1], flush=True)
    return rows


def certified(
    path: Path, sim: Backend, machine: Backend, way: str, seed: int, budget: int | None
) -> dict[str, Any]:
    """Return the line of a pilot, and the certificate with it."""
    with tempfile.TemporaryDirectory() as folder:
        how: dict[str, Any] = {"seed": seed, "executor": in_this_process}
        found = pilot(path, sim, Path(folder) / "pilot", real=machine, budget=budget, **how)
        line = found.line
        if way == "one B":
            declared = load_spec(path)
            units = [declared.params[one].measure.difference.text for one in declared.space.names]
            line = certify_line(found.requirement, shared(found.proposal.settings), units)
        text, _ = with_certify_line(path.read_text(), path.name, found.requirement, line)
        spec = parse_spec(text, path.name)
        how |= {"requirement": found.requirement, "stop": "decided", "budget": BUDGET}
        row: dict[str, Any] = {"way": way, "line": " ".join(line.split()), "pilot": found.tests * REPLICATES}
        try:
            with limited():
                result = s2r.certify(spec, sim, machine, Path(folder) / "run", **how)
        except OutOfTimeError:
            return row | {"verdict": "timed out", "real": 0}
    row |= {
        "verdict": result.verdict.value,
        "reason": result.reason,
        "real": 0 if result.gap is None else result.gap.certificate.rollouts,
        "simulated": result.simulated.certificate.rollouts,
    }
    if result.composition is None:
        return row
    lower, upper = result.composition.lower, result.composition.upper
    mean, error = worst_mean(spec, machine, result.composition.worst)
    return row | {
        "interval": [round(lower, 5), round(upper, 5)],
        "truth": round(mean, 5),
        "right": lower <= mean + 3 * error and mean - 3 * error <= upper,
    }


class OutOfTimeError(BaseException):
    """A certificate took :data:`LIMIT`; no Exception, because s2r would take that for an error of a rollout."""


@contextmanager
def limited() -> Iterator[None]:
    """Raise OutOfTimeError in the main thread of this process after :data:`LIMIT` of its time."""

    def stop(*_: object) -> None:
        raise OutOfTimeError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def shared(line: CertifySettings) -> CertifySettings:
    """Return a line whose search of the gap has B and epsilon of the check, or the gap's own if they are larger."""
    assert line.B
    assert line.epsilon
    assert line.gap_B
    assert line.gap_epsilon
    return replace(line, gap_B=max(line.B, line.gap_B), gap_epsilon=max(line.epsilon, line.gap_epsilon))


def simulated(seed: int) -> dict[str, Any]:
    """Run a pilot and both searches on random functions for E ρ and E Δ; return a row."""
    rng = np.random.default_rng([seed, 7])
    space, kernel = Space.of({"x": (0.0, 1.0)}), Kernel(str(rng.choice(FAMILIES)), rng.uniform(0.15, 0.6))
    centres, fine = rng.uniform(size=(12, 1)), np.linspace(0, 1, 2001)[:, None]
    weights = rng.normal(size=(12, 2))
    norms = np.sqrt(np.einsum("im,ij,jm->m", weights, kernel.gram(centres, centres), weights))
    weights *= np.array([0.3, rng.uniform(0.01, 0.15)]) / norms
    varied = kernel.gram(fine, centres) @ weights
    # The worst mean of the machine is 0.05 to 0.3 away from 0, on either side.
    level = float(rng.choice([-1, 1]) * rng.uniform(0.05, 0.3) - varied.sum(axis=1).min())
    truth = float(level + varied.sum(axis=1).min())

    def means(points: FloatArray) -> FloatArray:
        """Return (n, 2): E ρ of the simulator, and E Δ."""
        return np.asarray(kernel.gram(points, centres) @ weights) + np.array([level, 0.0])

    def draw(mean: FloatArray, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (count,) ρ of the simulator, ρ of the machine, and Δ, of one test."""
        sim = mean[0] + NOISE * rng.normal(size=(count, SIMULATED_PER_REAL))
        real = mean.sum() + NOISE * rng.normal(size=count)
        return sim.ravel(), real, real - sim.mean(axis=1)

    tests = design(space, None)
    drawn = [draw(mean, REPLICATES) for mean in means(tests.points)]
    sim, real, gaps = (Outcomes(tuple(group)) for group in zip(*drawn, strict=True))
    seen = Evidence(space, tests.points, tests.spacing, {"sim": sim, "real": real}, gaps, "")
    line = propose(seen, CertifySettings(), -2.0).settings
    first, second = _searches(space, line, seed)
    _run(first, lambda mean, count: -draw(mean, count)[0][:count], means)
    second.end_when(lambda: decides(first, second))
    _run(second, lambda mean, count: -draw(mean, count)[2], means)
    row: dict[str, Any] = {"way": "gap_B", "seed": seed, "real": second.certificate().rollouts}
    row["pilot"] = REPLICATES * len(tests.points)
    if not all(one.certificate().label.bounds for one in (first, second)):
        return row | {"verdict": "refused", "wrong": False}
    both = s2r.compose(first, second)
    verdict, positive = judge(both), truth >= 0
    wrong = not both.lower <= truth <= both.upper
    wrong |= verdict is (s2r.Verdict.VIOLATED if positive else s2r.Verdict.HOLDS)
    return row | {"verdict": verdict.value, "wrong": wrong}


def _searches(space: Space, line: CertifySettings, seed: int) -> tuple[Search, Search]:
    """Return search 1, and search 2 that stops at the verdict."""
    assert line.kernel
    kernel = Kernel(line.kernel.name, line.kernel.lengthscales)

    def search(own: CertifySettings, **more: Any) -> Search:
        declared = {name: getattr(own, name) for name in ("B", "R", "delta", "epsilon")}
        return Search(space, kernel=kernel, seed=seed, **declared, **more)

    second = of_gap(line, SIMULATED_PER_REAL)
    return search(line), search(second, stop="decided", repeats=True, budget=BUDGET)


def _run(search: Search, draw: Any, means: Any) -> None:
    """Answer a search to its end."""
    while not search.done:
        for query in search.ask():
            search.tell(query, draw(means(search.space.vector(query.point)[None])[0], query.replicates))


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one line for each way."""
    lines = []
    for way in dict.fromkeys(row["way"] for row in rows):
        own = [row for row in rows if row["way"] == way]
        decided = [row for row in own if row["verdict"] in ("holds", "violated")]
        lines.append(
            {
                "way": way,
                "runs": len(own),
                "verdicts": len(decided),
                "wrong": sum(row.get("wrong", not row.get("right", True)) for row in own),
                "at_most_30": sum(row["real"] <= 30 for row in decided),
                "median_real": float(np.median([row["real"] for row in decided])) if decided else None,
                "median_with_pilot": float(np.median([row["real"] + row["pilot"] for row in decided] or [0])),
            }
        )
    return lines


def main() -> None:
    """Run all, print a line for each run and each way."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--runs", type=int, default=RUNS, help="random functions")
    parser.add_argument("--twins", type=int, default=TWINS, help="twins of each simulator")
    parser.add_argument("--write", action="store_true", help="keep the result in the folder of results")
    options = parser.parse_args()
    jobs = [(name, seed) for seed in range(options.twins) for name in SPECS]
    with ProcessPoolExecutor(options.workers) as pool:
        twins = [row for rows in pool.map(twin, jobs) for row in rows]
        drawn = list(pool.map(simulated, range(options.runs), chunksize=4))
    table = [
        {"of": of} | row for of, rows in (("twins", twins), ("functions", drawn)) for row in summary(rows)
    ]
    for row in table:
        print(row)
    if options.write:
        RESULTS.write_text(
            document({"machine": [describe("numpy", "torch")], "summary": table, "twins": twins})
        )


if __name__ == "__main__":
    main()
