"""How much of the held-out gap the true cause closes in our own simulator, beside what the answers closed.

    python benchmarks/blind/reach.py a1 FOLDER [--workers 2]     # FOLDER: of `check.py freeze`, after `open`

A twin has 5 % of every other effect as background, numerics and laws of its own. So even the true effects at their
true values, added to the simulator, leave some of its gap: what they close is what naming and sizing could reach at
best. Every opened case with known causes is simulated so at its held-out tests, with the seeds and the floor of the
frozen answer, and set beside what that answer closed. This is for development: the labels are open.

Writes results/<set>_reach.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from machine import describe

from s2r_spec.backend import load_backend
from s2r_spec.diagnose.ask import real_rollouts
from s2r_spec.diagnose.bank import catalogue_of
from s2r_spec.diagnose.prepare import bench_of, split
from s2r_spec.diagnose.run import SHOTS
from s2r_spec.diagnose.simulate import Job, run_jobs
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.spec import load_spec

RESULTS = Path(__file__).parent / "results"
ROOT = Path(__file__).parents[2]
SETS = {"emps": ("specs/emps_tracking.stl", "emps"), "a1": ("specs/a1_velocity.stl", "sim")}
"""Set → its spec and its simulator."""
AS_MUCH = 0.95
"""Part of what the true cause closes that an answer should close."""


def reached(case: Path, name: str, kept: dict[str, Any]) -> float | None:
    """Return the share of the held-out gap above its floor that the true effects at their true values close."""
    path, simulator = SETS[name]
    spec = load_spec(ROOT / path)
    bench = bench_of(spec, spec.requirements[0], simulator)
    _, held = split(real_rollouts(bench, load_backend(f"log:{case}"), None, 0, None, lambda *_: None), 0)
    far = kept["how_far"]
    if not held or not far or not far["tuned_share"]:
        return None  # nothing was held out, or the gap is no more than scatter
    tests = [dict(key) for key in dict.fromkeys(tuple(sorted(test.items())) for test, _ in held)]
    runs = tuple(
        (test, rollout_seed(0, place, shot, Stream.GAP_SIM))
        for place, test in enumerate(tests)
        for shot in range(SHOTS)
    )
    declared = {e.name: {p.name for p in e.parameters} for e in catalogue_of(bench.backend)}
    true = {
        effect: {p: x for p, x in values.items() if p in declared[effect]}
        for effect, values in kept["label"]["effects"].items()
    }
    rows = run_jobs(bench, [Job(true, runs)], None)[0][:, 0].reshape(len(tests), SHOTS).mean(axis=1)
    left = float(
        np.mean([abs(bench.rho(trace, test) - rows[tests.index(dict(test))]) for test, trace in held])
    )
    before, floor = far["before"]["mean"], far["floor"]
    return (before - left) / max(before - floor, 0.2 * floor + 1e-12)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return medians over cases, and in how many the answer closes nearly what the true cause does."""
    if not rows:
        return {"cases": 0}
    return {
        "cases": len(rows),
        "true cause": round(float(np.median([row["true cause"] for row in rows])), 2),
        "answer": round(float(np.median([row["answer"] for row in rows])), 2),
        "tuned": round(float(np.median([row["tuned"] for row in rows])), 2),
        "answer closes nearly as much as the true cause": sum(
            row["answer"] >= AS_MUCH * row["true cause"] for row in rows
        ),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=tuple(SETS))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    scores = json.loads((RESULTS / f"{given.set}_scores.json").read_text())["cases"]
    known = {n: c for n, c in scores.items() if c["label"]["kind"] in ("single", "pair", "triple")}
    cases = [given.folder / given.set / "public" / name for name in known]
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        shares = list(pool.map(reached, cases, [given.set] * len(cases), known.values()))
    rows = []
    for kept, share in zip(known.values(), shares, strict=True):
        far, label = kept["how_far"], kept["label"]
        if share is None:
            continue
        row = {
            "kind": label["kind"],
            "effects": label["effects"],
            "material": far["material"],
            "true cause": round(share, 3),
            "answer": round(far["share"]["estimate"], 3) if far["share"] else 0.0,
            "tuned": round(far["tuned_share"]["estimate"], 3),
        }
        rows.append(row)
        print(row)
    told = {
        "of a material gap, single effects": summary(
            [r for r in rows if r["material"] and r["kind"] == "single"]
        ),
        "of a material gap, several": summary([r for r in rows if r["material"] and r["kind"] != "single"]),
    }
    print(json.dumps(told, indent=1))
    kept = {"machine": describe(), **told, "cases": rows}
    (RESULTS / f"{given.set}_reach.json").write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
