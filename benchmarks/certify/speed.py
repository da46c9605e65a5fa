"""What does a step of the search cost, and how does it grow with rollouts and test parameters?

A step chooses four tests, takes in their outcomes and bounds the box for 33 dual scales and four norms. ::

    OMP_NUM_THREADS=1 python -m benchmarks.certify.speed          # about 2 minutes
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import thread_time

import numpy as np

from benchmarks.machine import describe
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.search import Search

RESULTS = Path(__file__).parents[1] / "results" / "certify_speed.json"
KERNEL = Kernel("rbf", 0.2)


def step(dim: int, rollouts: int, points: int) -> float:
    """Return the median seconds of one whole step (ask, tell, tighten) near n rollouts."""
    space = {f"x{i}": (-0.2, 0.3) for i in range(dim)}
    search = Search(
        space, kernel=KERNEL, B=1.5, R=0.05, delta=0.1, epsilon=1e-4, seed=0, batch=points / rollouts
    )
    rng = np.random.default_rng(0)
    steps: list[float] = []
    while search.certificate().rollouts < rollouts:
        start = thread_time()
        for query in search.ask():
            x = np.array(list(query.point.values()))
            search.tell(query, 0.1 * np.sin(8 * x.sum()) + 0.05 * rng.normal(size=query.replicates))
        steps.append(thread_time() - start)
    return float(np.median(steps[-5:]))


def main() -> None:
    """Run all, print the table, write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    growth = [
        {"dim": dim, "rollouts": rollouts, "step_ms": 1e3 * step(dim, rollouts, 50)}
        for dim in (1, 2, 3, 4)
        for rollouts in (50, 100, 200, 400, 800)
    ]
    for row in growth:
        print(f"{row['dim']}-D, {row['rollouts']:4d} rollouts: one step takes {row['step_ms']:.1f} ms")
    record = {"machine": describe("numpy", "torch", "gpytorch"), "growth": growth}
    options.output.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
