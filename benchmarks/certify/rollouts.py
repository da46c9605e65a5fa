"""How many rollouts does a certificate take?

RBF with lengthscale 0.2 on [−0.2, 0.3], true norm 0.4, δ = 1e-6, R = 0.05, ε = 0.02: the
paper's simulator setting, for six norm bounds and every mode; what batches cost; and
smaller R. Medians over seeds, beside the floors that no method can beat. ::

    OMP_NUM_THREADS=1 python -m benchmarks.certify.rollouts          # about 5 minutes on 2 cores
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.certify.random_functions import Case, seeds, solve_all
from benchmarks.machine import describe
from s2r_spec.certify.bound.sample_complexity import minimax, sequential_lower_bound

RESULTS = Path(__file__).parents[1] / "results" / "certify_rollouts.json"
USUAL = Case(seed=0, norm=0.4, B=1.5, R=0.05, delta=1e-6, epsilon=0.02, budget=2_000_000)
BOUNDS = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0)


def main() -> None:
    """Run all, print the tables, write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows = []

    def measure(name: str, case: Case, runs: int = options.seeds) -> None:
        outcomes = solve_all(seeds(case, runs), options.workers)
        entry = {
            "name": name,
            "B": case.B,
            "R": case.R,
            "median_rollouts": int(np.median([outcome.rollouts for outcome in outcomes])),
            "mean_rollouts": round(float(np.mean([outcome.rollouts for outcome in outcomes])), 1),
            "median_iterations": int(np.median([outcome.iterations for outcome in outcomes])),
            "wrong": sum(outcome.wrong for outcome in outcomes),
            "runs": len(outcomes),
        }
        rows.append(entry)
        print(
            f"{name:36} B {case.B:3g} R {case.R:5g}: {entry['median_rollouts']:7d} rollouts in "
            f"{entry['median_iterations']:4d} batches, wrong {entry['wrong']} of {entry['runs']}",
            flush=True,
        )

    modes = {
        "rigorous, batches of 2 %": {"batch": 0.02},
        "rigorous, batches of 10 %": {},
        "rigorous-simple, batches of 10 %": {"mode": "rigorous-simple"},
        "paper, batches of 10 %": {"mode": "paper"},
    }
    for name, changes in modes.items():
        for bound in BOUNDS:
            measure(name, replace(USUAL, B=bound, **changes))
    for spread in (1, 4, 16):
        measure(f"rigorous, {spread} tests a batch", replace(USUAL, spread=spread))
    for noise in (0.02, 0.01, 0.005, 0.001):
        measure("rigorous, smaller R", replace(USUAL, R=noise))
        measure("rigorous, smaller R, 1 test a batch", replace(USUAL, R=noise, spread=1))
    # So few rollouts are a matter of luck: over more functions, too.
    measure("rigorous, smaller R, more functions", replace(USUAL, R=0.005), 5 * options.seeds)
    floors = {
        "sequential_floor": sequential_lower_bound(USUAL.R, USUAL.epsilon, USUAL.delta),
        "minimax": minimax(USUAL.R, USUAL.epsilon, USUAL.delta),
    }
    print(
        f"no method below {floors['sequential_floor']:.0f} on average; one known test {floors['minimax']:.0f}"
    )
    record = {"machine": describe("numpy", "torch", "gpytorch"), "floors": floors, "rows": rows}
    options.output.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
