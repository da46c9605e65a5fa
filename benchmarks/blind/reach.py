"""How much of the held-out gap the true cause closes in our own simulator, beside what the answers closed.

    python benchmarks/blind/reach.py a1 FOLDER [--workers 2]     # FOLDER: of `check.py freeze`, after `open`

A twin has 5 % of every other effect as background, numerics and laws of its own. So even the true effects at their
true values, added to the simulator, leave some of its gap: what they close is what naming and sizing could reach at
best. Every opened case with known causes is simulated so at its held-out tests, with the seeds and the floor of the
frozen answer, and set beside what that answer closed. This is for development: the labels are open.

Writes results/<set>_reach.json.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from opened import Opened, bench, held_out

from s2r_spec.diagnose.gap import SHOTS
from s2r_spec.diagnose.simulate import Job, run_jobs
from s2r_spec.effects import catalogue_of
from s2r_spec.rollouts.seeds import Stream, rollout_seed

AS_MUCH = 0.95
"""Part of what the true cause closes that an answer should close."""


def reached(case: Path, name: str, kept: dict[str, Any]) -> float | None:
    """Return the share of the held-out gap above its floor that the true effects at their true values close."""
    ours = bench(name)
    held = held_out(ours, case)
    far = kept["how_far"]
    if not held or not far or not far["tuned_share"]:
        return None  # nothing was held out, or the gap is no more than scatter
    tests = [dict(key) for key in dict.fromkeys(tuple(sorted(test.items())) for test, _ in held)]
    runs = tuple(
        (test, rollout_seed(0, place, shot, Stream.GAP_SIM))
        for place, test in enumerate(tests)
        for shot in range(SHOTS)
    )
    declared = {e.name: {p.name for p in e.parameters} for e in catalogue_of(ours.backend)}
    true = {
        effect: {p: x for p, x in values.items() if p in declared[effect]}
        for effect, values in kept["label"]["effects"].items()
    }
    rows = run_jobs(ours, [Job(true, runs)], None)[0][:, 0].reshape(len(tests), SHOTS).mean(axis=1)
    left = float(
        np.mean([abs(ours.rho(trace, test) - rows[tests.index(dict(test))]) for test, trace in held])
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
    opened = Opened.asked_for(__doc__)
    known = {n: c for n, c in opened.cases().items() if c["label"]["kind"] in ("single", "pair", "triple")}
    shares = opened.over(reached, known, list(known.values()))
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
    opened.write("reach", {**told, "cases": rows})


if __name__ == "__main__":
    main()
