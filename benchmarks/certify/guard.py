"""Is a norm bound that is too small ever silent?

B from six times to a quarter of the true norm, 200 runs a cell: a certificate
that is wrong and not refused is the one outcome that must not occur. ::

    OMP_NUM_THREADS=1 python -m benchmarks.certify.guard          # about 5 minutes on 2 cores
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.certify.random_functions import Case, seeds, solve_all
from benchmarks.machine import describe

RESULTS = Path(__file__).parents[1] / "results" / "certify_guard.json"
RATIOS = (6, 3, 2, 1.5, 1, 0.9, 0.75, 0.5, 0.25)


def main() -> int:
    """Run all cells, print the table, write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows = []
    for kernel in ("rbf", "matern52"):
        for ratio in RATIOS:
            case = Case(
                0, norm=1.5, B=1.5 * ratio, R=0.05, delta=0.1, epsilon=0.06, kernel=kernel, budget=20_000
            )
            outcomes = solve_all(seeds(case, options.runs), options.workers)
            entry = {
                "kernel": kernel,
                "B_over_norm": ratio,
                "runs": options.runs,
                "refused": sum(outcome.label == "REFUSED" for outcome in outcomes),
                "wrong": sum(outcome.wrong for outcome in outcomes),
                "wrong_and_silent": sum(outcome.wrong and outcome.label != "REFUSED" for outcome in outcomes),
                "median_B_low_over_norm": float(np.median([outcome.B_low for outcome in outcomes]) / 1.5),
                "median_rollouts": int(np.median([outcome.rollouts for outcome in outcomes])),
            }
            rows.append(entry)
            print(
                f"{kernel:9} B = {ratio:4g} × norm: refused {entry['refused']:3d}, wrong {entry['wrong']:3d}, "
                f"wrong and silent {entry['wrong_and_silent']} of {options.runs}; "
                f"B_low {entry['median_B_low_over_norm']:.2f} × norm, {entry['median_rollouts']} rollouts",
                flush=True,
            )
    silent = sum(int(entry["wrong_and_silent"]) for entry in rows)  # type: ignore[call-overload]
    record = {"machine": describe("numpy", "torch", "gpytorch"), "rows": rows, "wrong_and_silent": silent}
    options.output.write_text(json.dumps(record, indent=2) + "\n")
    print(f"wrong and silent: {silent} of {len(rows) * options.runs}")
    return int(silent > 0)


if __name__ == "__main__":
    sys.exit(main())
