"""Does the certificate's interval contain the truth?

Runs the A1 at 11 speeds × 20 seeds, takes the smallest mean ρ as the reference,
runs `s2r check` beside it with its own seeds, and says whether the interval
contains the reference. ::

    python -m benchmarks.certify.dense_reference            # 1 to 3 minutes on 2 cores
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

import s2r_spec as s2r
from benchmarks.machine import describe
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.seeds import rollout_seed
from s2r_spec.runs.task import Task
from s2r_spec.workers.pools import process_pool

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "dense_reference.json"
# The check runs with seed 0; the reference must not share its rollouts.
SEED = 20_000


def reference(spec: s2r.Spec, speeds: int, seeds: int, workers: int) -> list[dict[str, float]]:
    """Return mean, standard deviation and standard error of ρ at every speed."""
    axis = spec.space.axes[0]
    grid = np.linspace(axis.low, axis.high, speeds)
    tasks = [
        Task(q, r, "sim", {axis.name: float(v)}, rollout_seed(SEED, q, r), channels=("vx",))
        for q, v in enumerate(grid)
        for r in range(seeds)
    ]
    rho: dict[int, list[float]] = {q: [] for q in range(speeds)}
    with Runner(process_pool(workers)) as runner:
        for done in runner.run(tasks):
            assert done.trace is not None
            assert done.trace.failure is None, f"a nominal A1 fell at {done.task.params}"
            rho[done.task.query].append(spec.robustness(done.trace, params=done.task.params)["walking"])
    return [
        {
            axis.name: round(float(v), 10),
            "mean": float(np.mean(rho[q])),
            "std": float(np.std(rho[q], ddof=1)),
            "standard_error": float(np.std(rho[q], ddof=1) / np.sqrt(seeds)),
            "lowest": min(rho[q]),
        }
        for q, v in enumerate(grid)
    ]


def main() -> int:
    """Run both, print the table, write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speeds", type=int, default=11)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    spec = s2r.load_spec(ROOT / "specs" / "a1_velocity.stl")
    rows = reference(spec, options.speeds, options.seeds, options.workers)
    for row in rows:
        print(
            f"vd {row['vd']:+.2f} m/s: ρ {row['mean']:+.4f} ± {row['standard_error']:.4f} (std {row['std']:.4f})"
        )
    with tempfile.TemporaryDirectory() as folder:
        result = s2r.check(spec, "sim", Path(folder) / "run", executor=process_pool(options.workers))
    worst = min(rows, key=lambda row: row["mean"])
    contained = result.lower <= worst["mean"] <= result.upper
    print(f"reference minimum {worst['mean']:+.4f} at vd {worst['vd']:+.2f}")
    print(
        f"certificate       [{result.lower:+.4f}, {result.upper:+.4f}] after {result.certificate.rollouts} rollouts"
    )
    print("contained" if contained else "NOT CONTAINED")
    record = {
        "machine": describe("mujoco", "pin", "piqp", "torch", "gpytorch"),
        "spec_hash": spec.hash,
        "model_hash": result.provenance["model_hash"],
        "reference": rows,
        "reference_minimum": worst,
        "certificate": {
            "lower": result.lower,
            "upper": result.upper,
            "delta": result.certificate.delta,
            "label": result.certificate.label.value,
            "rollouts": result.certificate.rollouts,
            "worst": asdict(result.worst),
            "seconds": round(result.seconds, 1),
        },
        "contained": contained,
    }
    options.output.write_text(json.dumps(record, indent=2, allow_nan=False) + "\n")
    return 0 if contained else 1


if __name__ == "__main__":
    sys.exit(main())
