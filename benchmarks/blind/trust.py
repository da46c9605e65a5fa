"""How far the networks should be trusted where traces look strange: what a set's answers would have been otherwise.

    python benchmarks/blind/trust.py a1 FOLDER    # FOLDER: where check.py made a set that is open

Diagnoses the known causes of the set again, up to the probabilities of sets, and weighs each time three times: the
networks trusted by the probability that the cause is in the catalogue (``s2r diagnose``), in full, and not at all.
Every case is kept in ``results/<set>_trust.json`` before the next begins, and those that are there are not run again.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.backend import load_backend
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.ask import real_rollouts
from s2r_spec.diagnose.parted import Parted
from s2r_spec.diagnose.prepare import bench_of, by_equations, prepare
from s2r_spec.diagnose.together import together
from s2r_spec.spec import load_spec

RESULTS = Path(__file__).parent / "results"
SIMULATORS = {"emps": "emps", "a1": "sim"}
WAYS = ("as far as the traces are known", "in full", "not at all")
LEAST = 1e-4
"""Probability that the truth is given at least, for the mean of its logarithm."""


def weighed(case: Path, simulator: str, effects: list[str]) -> dict[str, Any]:
    """Return P(unknown) by the traces and, for every way, the truth's probability and the likeliest set with its."""
    spec = load_spec(case / "spec.stl")
    bench = bench_of(spec, spec.requirements[0], simulator)
    bank = banks.bank(bench)
    bench = replace(bench, features=bank.features)
    recorded = real_rollouts(bench, load_backend(f"log:{case}"), None, 0, None, lambda *_: None)
    state = prepare(bench, bank, Parted.of(recorded, 0).compared, 0, None, None, lambda *_: None)
    found = together(state, lambda *_: None)
    names = state.judge.effects
    members = found.sets.members
    evidence = replace(state.found, members=members, logs=found.logs)
    heard = by_equations(state.heard, names, members)
    true = tuple(sorted(names.index(effect) for effect in effects))
    ways = {}
    for way, unknown in zip(WAYS, (state.unknown, 0.0, 1.0), strict=True):
        sets = state.judge.sets(evidence, state.memberships, found.temperature, unknown, heard)
        likeliest, probability = sets.ranked()[0]
        of = dict(zip(sets.members, sets.probability.tolist(), strict=True))
        ways[way] = {
            "truth": round(of.get(true, 0.0), 4),
            "likeliest": [names[k] for k in likeliest],
            "probability": round(probability, 3),
        }
    return {"effects": effects, "unknown": round(state.unknown, 3), "ways": ways}


def summary(cases: dict[str, Any]) -> str:
    """Return a line for every kind and way."""
    lines = []
    for count, kind in ((1, "single effects"), (2, "pairs")):
        mine = [case for case in cases.values() if len(case["effects"]) == count]
        for way in WAYS if mine else ():
            told = [(case["ways"][way], set(case["effects"])) for case in mine]
            hits = sum(set(one["likeliest"]) == true for one, true in told)
            mean = float(np.mean([np.log(max(one["truth"], LEAST)) for one, _ in told]))
            lines.append(
                f"{kind}, networks trusted {way}: {hits} of {len(mine)}, mean log probability {mean:.2f}"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("set", choices=tuple(SIMULATORS))
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    labels = json.loads((given.folder / f"{given.set}-answers" / "opened.json").read_text())["labels"]
    path = RESULTS / f"{given.set}_trust.json"
    kept: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    for name, label in sorted(labels.items()):
        if label["kind"] in ("single", "pair") and name not in kept:
            case = given.folder / given.set / "public" / name
            kept[name] = weighed(case, SIMULATORS[given.set], list(label["effects"]))
            path.write_text(json.dumps(kept, indent=1) + "\n")
    print(summary(kept))


if __name__ == "__main__":
    main()
