"""How much the closed loop's evidence should count beside networks and equations: the log score on known machines.

    python -m benchmarks.blind.outsiders.generate quad --cases 80 --seed 3411 --held-out 0 --out FOLDER
    python benchmarks/blind/weigh.py quad FOLDER     # FOLDER: what a generator wrote, with labels

Reads public/ and sealed/ of a set that was made with a seed and is used for no score. Prints for some weights of the
evidence, the others as they are in s2r_spec/diagnose/judge.py (WEIGHTS), the log score of the true set, how often it is
the likeliest, and how often an answer of 0.9 and more is right; keeps that in results/weigh.json, beside other sets'.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

from machine import describe  # noqa: E402

from benchmarks.blind.check import SETS, offered  # noqa: E402
from s2r_spec.backend import load_backend  # noqa: E402
from s2r_spec.diagnose import bank as banks  # noqa: E402
from s2r_spec.diagnose.ask import real_rollouts  # noqa: E402
from s2r_spec.diagnose.evidence import Evidence  # noqa: E402
from s2r_spec.diagnose.idle import active  # noqa: E402
from s2r_spec.diagnose.judge import Judge  # noqa: E402
from s2r_spec.diagnose.prepare import State, bench_of, by_equations, prepare  # noqa: E402
from s2r_spec.diagnose.together import Together, together  # noqa: E402
from s2r_spec.spec import load_spec  # noqa: E402

RESULTS = Path(__file__).parent / "results" / "weigh.json"
WEIGHTS = (0.5, 1.0, 1.4, 2.0, 2.8, 4.0)
LEAST = -8.0
"""A log probability is no less than this in the score: one case is not all of it."""
Row = tuple[State, Together, tuple[int, ...]]


def rows(name: str, folder: Path) -> list[Row]:
    """Return what sets were weighed by, and the true set, of the cases with known causes."""
    out: list[Row] = []
    for case in sorted(path for path in (folder / "public").iterdir() if path.is_dir()):
        label = json.loads((folder / "sealed" / f"{case.name}.json").read_text())
        if label["kind"] == "unknown":
            continue
        spec = load_spec(case / "spec.stl")
        bench = bench_of(spec, spec.requirements[0], SETS[name][1])
        bank, _ = active(banks.bank(bench))
        bench = replace(bench, features=bank.features)
        seen = real_rollouts(bench, load_backend(f"log:{case}"), None, 0, None, lambda *_: None)
        state = prepare(bench, bank, seen, 0, None, None, lambda *_: None)
        true = tuple(sorted(state.judge.effects.index(effect) for effect in label["effects"]))
        out.append((state, together(state, lambda *_: None), true))
        print(f"{case.name}: temperature {out[-1][1].temperature:.1f}", file=sys.stderr)
    return out


def scored(cases: list[Row], weight: float) -> dict[str, Any]:
    """Return the log score, and how often the likeliest set is the true one, at a weight of the evidence."""
    logs, sure = [], []
    right: dict[str, list[bool]] = {"nothing": [], "single": [], "more": []}
    for state, found, true in cases:
        judge: Judge = replace(state.judge, weights=replace(state.judge.weights, evidence=weight))
        told = by_equations(state.heard, state.judge.effects, found.sets.members)
        evidence: Evidence = replace(state.found, members=found.sets.members, logs=found.logs)
        sets = judge.sets(evidence, state.memberships, found.temperature, state.unknown, told)
        p = dict(zip(sets.members, sets.probability.tolist(), strict=True))
        first, most = sets.ranked()[0]
        logs.append(max(float(np.log(max(p.get(true, 0.0), 1e-300))), LEAST))
        right[("nothing", "single", "more")[min(len(true), 2)]].append(first == true)
        if most >= 0.9:
            sure.append(first == true)
    return {
        "log score": round(float(np.mean(logs)), 3),
        **{kind: [sum(hits), len(hits)] for kind, hits in right.items()},
        "sure": [sum(sure), len(sure)],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=tuple(SETS))
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    sys.path[:0] = offered(given.set).get("PYTHONPATH", "").split(os.pathsep)
    cases = rows(given.set, given.folder)
    found = {f"{weight:g}": scored(cases, weight) for weight in WEIGHTS}
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"sets": {}}
    kept["machine"] = describe("scikit-learn", "numpy")
    kept["sets"][given.set] = found
    RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
    for weight, each in found.items():
        print(f"{given.set} evidence × {weight:4} {each}")


if __name__ == "__main__":
    main()
