"""How evidence and networks should be weighed: the best log score on twins made for development.

    python benchmarks/blind/weigh.py emps FOLDER     # FOLDER: what a generator wrote, with labels

Reads public/ and sealed/ of a set that was made with a seed and is used for nothing else, and prints
the log score of the sets' probabilities over how many features count as independent, the other weights fitted to each.
What is in s2r_spec/diagnose/judge.py (WEIGHTS) was rounded from this, before the fifth sealed set changed the evidence.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from s2r_spec.backend import load_backend
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.ask import real_rollouts
from s2r_spec.diagnose.judge import COLDEST, votes
from s2r_spec.diagnose.prepare import bench_of, prepare
from s2r_spec.diagnose.together import together
from s2r_spec.spec import load_spec

FloatArray = NDArray[np.float64]
Row = tuple[FloatArray, FloatArray, NDArray[np.intp], int, float]
SIMULATORS = {"emps": "emps", "a1": "sim"}


def rows(name: str, folder: Path) -> list[Row]:
    """Return log evidence, votes, sizes, the true set's place and how many numbers there are, of known causes."""
    out: list[Row] = []
    for case in sorted((folder / "public").iterdir()):
        label = json.loads((folder / "sealed" / f"{case.name}.json").read_text())
        if label["kind"] == "unknown":
            continue
        spec = load_spec(case / "spec.stl")
        bench = bench_of(spec, spec.requirements[0], SIMULATORS[name])
        bank = banks.bank(bench)
        bench = replace(bench, features=bank.features)
        logs = load_backend(f"log:{case}")
        seen = real_rollouts(bench, logs, None, 0, None, lambda *_: None)
        state = prepare(bench, bank, seen, 0, None, None, lambda *_: None)
        true = tuple(sorted(state.judge.effects.index(e) for e in label["effects"]))
        if true in state.found.members:
            abstained = np.full(len(state.judge.effects), 0.5)
            said = abstained if state.memberships is None else state.memberships
            vote, sizes = votes(state.found.members, said)
            weighed = together(state, lambda *_: None)
            # What the temperature would be of one independent number.
            cold = weighed.temperature * state.judge.weights.independent
            out.append((weighed.logs[: len(vote)], vote, sizes, state.found.members.index(true), cold))
    return out


def loss(free: FloatArray, independent: float, cases: list[Row]) -> float:
    """Return the mean −log probability of the true set."""
    total = 0.0
    for logs, vote, sizes, true, count in cases:
        score = (
            (logs - logs.max()) / max(count / independent, COLDEST)
            + np.exp(free[0]) * vote
            - np.concatenate([[0.0], free[1:]])[sizes]
        )
        total += float(np.logaddexp.reduce(score) - score[true])
    return total / len(cases)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=tuple(SIMULATORS))
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    cases = rows(given.set, given.folder)
    print(f"{len(cases)} cases\nindependent  log score  trust  penalties of 1, 2, 3 effects")
    for independent in (20.0, 40.0, 50.0, 80.0, 160.0, 320.0):
        best = minimize(loss, [-0.5, 0.0, 2.0, 4.0], args=(independent, cases), method="Nelder-Mead")
        trust, *penalty = best.x
        print(
            f"{independent:11g} {best.fun:10.3f} {np.exp(trust):6.2f}  {', '.join(f'{p:.2f}' for p in penalty)}"
        )


if __name__ == "__main__":
    main()
