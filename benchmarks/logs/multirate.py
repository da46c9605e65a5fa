"""Random logs of several topics: does s2r ever say what their messages deny?

    python -m benchmarks.logs.multirate --logs 10000 --seed 0 --write

Each seed is a log with planted faults, in one format, and a formula (tests/logs/multirate_cases.py). The evaluator of
tests/logs/multirate_truth.py says what all messages mean, without s2r_spec.robustness. ``--write`` writes the counts
and the seeds of wrong answers to results/multirate_logs.json.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

from benchmarks.machine import describe
from tests.logs.multirate_cases import case
from tests.logs.multirate_check import checked

STATUSES = ("equal", "unknown", "cautious", "refused", "borderline", "wrong")
RESULTS = Path(__file__).parents[1] / "results" / "multirate_logs.json"


def measured(seeds: range) -> dict[str, object]:
    """Return the counts by fault and by format, and the seeds of wrong answers."""
    faults: dict[str, Counter[str]] = defaultdict(Counter)
    formats: dict[str, Counter[str]] = defaultdict(Counter)
    total: Counter[str] = Counter()
    wrong = {}
    holds = 0
    for seed in seeds:
        made = case(seed)
        with tempfile.TemporaryDirectory() as folder:
            outcome = checked(made, Path(folder))
        total[outcome.status] += 1
        formats[made.format][outcome.status] += 1
        for fault in made.log.faults or ("none",):
            faults[fault][outcome.status] += 1
        if outcome.status == "wrong":
            wrong[str(seed)] = outcome.why.strip().splitlines()[0]
            holds += bool(outcome.verdict)
    return {
        "logs": len(seeds),
        "seed": seeds.start,
        "total": dict(total),
        "wrong holds": holds,
        "by fault": {name: dict(counts) for name, counts in sorted(faults.items())},
        "by format": {name: dict(counts) for name, counts in sorted(formats.items())},
        "wrong": wrong,
    }


def table(found: dict[str, object]) -> str:
    """Return one table of all counts."""
    rows = [("all", found["total"])]
    for part in ("by fault", "by format"):
        rows += [(f"{part[3:]} {name}", counts) for name, counts in found[part].items()]  # type: ignore[attr-defined]
    lines = [f"{'':24}" + "".join(f"{status:>12}" for status in STATUSES)]
    lines += [
        f"{name:24}" + "".join(f"{counts.get(status, 0):>12}" for status in STATUSES)  # type: ignore[attr-defined]
        for name, counts in rows
    ]
    return "\n".join(lines)


def main() -> None:
    """Try as many as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    began = time.perf_counter()
    found = measured(range(given.seed, given.seed + given.logs))
    print(table(found))
    for seed, why in found["wrong"].items():  # type: ignore[attr-defined]
        print(f"seed {seed}: {why[:200]}")
    if given.write:
        record = {"machine": describe("numpy"), "seconds": round(time.perf_counter() - began), **found}
        RESULTS.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    raise SystemExit(bool(found["wrong"]))


if __name__ == "__main__":
    main()
