"""What simpler ways make of the same sealed cases: which single effect they would name.

    python benchmarks/blind/baselines.py emps FOLDER     # FOLDER: of `check.py freeze`, after `open`

For the cases with one effect, and beside what the frozen answers name first:

- joint least squares: the whole catalogue fitted at once, hardly held back; the effect that moved furthest,
  in parts of its typical size (what a system identification would blame);
- single fits: each effect alone, over its range; the one that leaves least (BIC, all of one parameter);
- ρ only: the same, of ρ and nothing else;
- chance.

Writes results/<set>_baselines.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from machine import describe

from s2r_spec.backend import load_backend
from s2r_spec.blind.score import Rate, ranked, truth
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.ask import real_rollouts
from s2r_spec.diagnose.joint import joint_fit
from s2r_spec.diagnose.prepare import bench_of, prepare
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.spec import load_spec

RESULTS = Path(__file__).parent / "results"
SIMULATORS = {"emps": "emps", "a1": "sim"}
FREE = 3.0
"""Standard deviation of a coordinate in the joint fit, in parts of a typical effect."""


@cache
def known(spec: Path, simulator: str) -> tuple[Bench, banks.Bank]:
    """Return bench and bank, the same for all cases of a set."""
    bench = bench_of(load_spec(spec), load_spec(spec).requirements[0], simulator)
    bank = banks.bank(bench)
    return replace(bench, features=bank.features), bank


def named(case: Path, simulator: str) -> dict[str, str]:
    """Return what each baseline would name."""
    bench, bank = known(case.parents[2] / "spec.stl", simulator)
    seen = real_rollouts(bench, load_backend(f"log:{case}"), None, 0, None, lambda *_: None)
    state = prepare(bench, bank, seen, 0, None, None, lambda *_: None)
    view = state.view
    catalogue, surrogate = view.surrogate.catalogue, view.surrogate
    begin = surrogate.turned(view.data, view.variance)
    free = joint_fit(
        state.simulator,
        view.data,
        view.variance,
        view.nuisances,
        begin,
        surrogate.jacobian(begin),
        FREE,
    )
    moved = np.where(catalogue.based, 0.0, np.abs(free.at))
    places = range(len(catalogue.effects))
    alone = [surrogate.scanned(view.data, view.variance, k, begin)[1] for k in places]
    gap = {tuple(sorted(test.items())): [] for test, _ in seen}
    for test, trace in seen:
        gap[tuple(sorted(test.items()))].append(bench.rho(trace, test))
    nominal = {
        key: np.mean([bench.rho(bench.run({}, dict(key), s), dict(key)) for s in range(2)]) for key in gap
    }
    away = np.array(
        [np.mean(gap[key]) - nominal[key] for key in (tuple(sorted(t.items())) for t in view.layout.tests)]
    )
    left = [np.inf] * len(catalogue.effects)
    for k, curve in enumerate(catalogue.curves):
        if not catalogue.based[k]:
            rest = away - curve.rho @ view.layout.interpolate.T
            left[catalogue.owner[k]] = min(left[catalogue.owner[k]], float((rest**2).sum(axis=1).min()))
    return {
        "joint least squares": catalogue.effects[catalogue.owner[int(moved.argmax())]],
        "single fits": catalogue.effects[int(np.argmax(alone))],
        "ρ only": catalogue.effects[int(np.argmin(left))],
        "effects": str(len(catalogue.effects)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=tuple(SIMULATORS))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    answers = given.folder / f"{given.set}-answers"
    labels = json.loads((answers / "opened.json").read_text())["labels"]
    single = [
        name
        for name, label in labels.items()
        if label["kind"] == "single" and (answers / f"{name}.json").exists()
    ]
    cases = [given.folder / given.set / "public" / name for name in single]
    # All cases of a set have one spec.
    (given.folder / "spec.stl").write_bytes((cases[0] / "spec.stl").read_bytes())
    known(given.folder / "spec.stl", SIMULATORS[given.set])
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        found = list(pool.map(named, cases, [SIMULATORS[given.set]] * len(cases)))
    true = [next(iter(truth(labels[name]))) for name in single]
    rates = {
        way: Rate(sum(each[way] == right for each, right in zip(found, true, strict=True)), len(single))
        for way in ("joint least squares", "single fits", "ρ only")
    }
    frozen = [json.loads((answers / f"{name}.json").read_text()) for name in single]
    first = [
        next(s for s, _ in ranked(answer) if not s & {"none", "unknown"}) == {right}
        for answer, right in zip(frozen, true, strict=True)
    ]
    rates["s2r diagnose, likeliest cause"] = Rate(sum(first), len(first))
    kept = {
        "machine": describe("numpy", "scipy", "scikit-learn"),
        "chance": 1 / int(found[0]["effects"]),
        "rates": {way: rate.to_json() for way, rate in rates.items()},
    }
    (RESULTS / f"{given.set}_baselines.json").write_text(
        json.dumps(kept, indent=1, ensure_ascii=False) + "\n"
    )
    print(f"{len(single)} cases with one effect; chance {kept['chance']:.3f}")
    for way, rate in rates.items():
        print(f"{way:30} {rate.value:.3f}  {rate.hits} of {rate.of}")


if __name__ == "__main__":
    main()
