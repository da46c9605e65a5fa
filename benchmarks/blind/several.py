"""What is said of machines with more than three effects, which the sealed sets do not have.

    python benchmarks/blind/several.py [--workers 2]     # some 10 minutes of two cores

Real machines seen from an ideal simulator have several effects at once. The machines are axes of the blind check's
generator (`emps/`: other code, a little of everything else) with four and five effects of random sizes, from fixed
seeds: nothing is sealed here. Each is diagnosed from 30 rollouts. Counted are the effects that are there and named,
those that are named and not there, how often a set of probability 0.9 or more is all that is there, and the part of
the held-out gap that the named effects close.

Writes results/several.json.
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

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

import s2r_spec as s2r  # noqa: E402
from benchmarks.blind.emps import cases  # noqa: E402
from benchmarks.machine import describe  # noqa: E402
from s2r_spec.diagnose import diagnose  # noqa: E402

RESULTS = Path(__file__).parent / "results" / "several.json"
EFFECTS, MACHINES, BUDGET = (4, 5), 8, 30
SURE = 0.9


def diagnosed(asked: tuple[int, int]) -> dict[str, Any]:
    """Make a machine with so many effects, by its number, and diagnose it."""
    count, number = asked
    rng = np.random.default_rng([23, count, number])
    names = sorted(map(str, rng.choice(sorted(cases.KNOWN), count, replace=False)))
    drawn = cases.machine_of(rng, [cases.KNOWN[name] for name in names])
    nuisances = [cases.drawn_nuisance(rng) for _ in range(BUDGET)]
    plan = cases.Plan(
        drawn.machine, drawn.bare, cases.drawn_tests(rng, BUDGET), [], nuisances, {"effects": {}}
    )
    spec = s2r.load_spec(ROOT / "specs" / "emps_tracking.stl")
    rollouts = list(cases.realise([plan])[0].rollouts)
    found = diagnose(spec, "emps", rollouts, where=False, passive=True)
    (first, probability), far = found.which.ranked[0], found.how_far
    closed = None if far is None or far.share is None else round(far.share.estimate, 3)
    return {
        "effects": drawn.effects,
        "verdict": found.verdict.value,
        "named": sorted(found.which.answer),
        "likeliest": sorted(first),
        "probability": round(probability, 3),
        "material": bool(far and far.material),
        "closed": closed,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts over machines."""
    there = [set(row["effects"]) for row in rows]
    named = [set(row["named"]) for row in rows]
    sure = [row for row in rows if row["probability"] >= SURE and row["verdict"] != "none of these"]
    return {
        "machines": len(rows),
        "effects": sum(map(len, there)),
        "of these named": sum(len(a & b) for a, b in zip(there, named, strict=True)),
        "named and not there": sum(len(b - a) for a, b in zip(there, named, strict=True)),
        "all and no other": sum(a == b for a, b in zip(there, named, strict=True)),
        "answers of 0.9 and more": len(sure),
        "of these right": sum(set(row["likeliest"]) == set(row["effects"]) for row in sure),
        "none of these": sum(row["verdict"] == "none of these" for row in rows),
        "closed, median": round(
            float(np.median([row["closed"] or 0.0 for row in rows if row["material"]])), 2
        ),
    }


def main() -> None:
    """Make, diagnose, count, write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    asked = [(count, number) for count in EFFECTS for number in range(MACHINES)]
    rows = []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for row in pool.map(diagnosed, asked):
            print(json.dumps(row), flush=True)
            rows.append(row)
    told = {
        f"{count} effects": summary([row for row in rows if len(row["effects"]) == count])
        for count in EFFECTS
    }
    print(json.dumps(told, indent=1))
    kept = {"machine": describe("scipy"), **told, "machines": rows}
    RESULTS.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
