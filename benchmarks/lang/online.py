"""What a sample costs online, for windows of any length and traces of any length.

    OMP_NUM_THREADS=1 python -m benchmarks.lang.online

At 0.01 s a sample, in time of this process: the robust interval at the first time (Spec.monitor), and ρ at
every sample (Spec.robustness_stream). A window of w samples is filled first; the samples after that are timed,
on average ("us") and each by itself ("worst us", the slowest of them: now and then a queue is turned over, or
memory is cleared). "growth" runs one trace for a million samples and gives the time of every tenth of it.
Writes results/online.json.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.machine import describe
from s2r_spec.spec import parse_spec

RESULTS = Path(__file__).parents[1] / "results" / "online.json"
WINDOWS = [10, 100, 1000, 10_000, 100_000]
TIMED = 20_000
STREAMS = {
    "always": "always[0, W] (x <= 1)",
    "always eventually": "always[0, W] eventually[0, W] (x > 0.5)",
    "until": "x > 0 until[0, W] y > 0",
    "since": "x > 0 since[0, W] y > 0",
    "mean": "mean(x, W) <= 1",
}
MONITORS = {
    "always": "always[0, W] (x <= 1)",
    "until": "x > -9 until[0, W] y > 9",
    "response": "always[0, 1000000 s] (x > 0 -> eventually[0, W] y > 0)",
    "response until": "always[0, 1000000 s] (x > 0 -> x > -1 until[0, W] y > 0)",
}
GROWTH = 1_000_000


def samples(count: int) -> list[dict[str, float]]:
    """Return samples of two smooth signals with noise."""
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(count)
    x, y = np.sin(time) + 0.1 * rng.normal(size=count), np.cos(0.7 * time) + 0.1 * rng.normal(size=count)
    return [{"x": a, "y": b} for a, b in zip(x.tolist(), y.tolist(), strict=True)]


def opened(formula: str, window: int, stream: bool) -> Callable[[float, dict[str, float]], object]:
    spec = parse_spec(f"signal x signal y const W {{s}} = {window / 100} require it: {formula}")
    return (spec.robustness_stream if stream else spec.monitor)(period=0.01).update


def cost(formula: str, window: int, stream: bool, given: list[dict[str, float]]) -> dict[str, float]:
    """Return the time of a sample once the window is full [us]."""
    update = opened(formula, window, stream)
    fill = 2 * window + 100
    for k in range(fill):
        update(k / 100, given[k])
    start = process_time()
    for k in range(fill, fill + TIMED // 2):
        update(k / 100, given[k])
    mean = (process_time() - start) / (TIMED // 2)
    worst = 0.0
    for k in range(fill + TIMED // 2, fill + TIMED):
        start = process_time()
        update(k / 100, given[k])
        worst = max(worst, process_time() - start)
    return {"us": round(1e6 * mean, 2), "worst us": round(1e6 * worst, 1)}


def growth(formula: str, window: int, stream: bool, given: list[dict[str, float]]) -> list[float]:
    """Return the time of a sample in every tenth of a long trace [us]."""
    update = opened(formula, window, stream)
    tenth, found = GROWTH // 10, []
    for part in range(10):
        start = process_time()
        for k in range(part * tenth, (part + 1) * tenth):
            update(k / 100, given[k])
        found.append(round(1e6 * (process_time() - start) / tenth, 2))
    return found


def main() -> None:
    given = samples(2 * WINDOWS[-1] + 100 + TIMED)
    rows: list[dict[str, object]] = []
    for kind, formulas in (("stream", STREAMS), ("monitor", MONITORS)):
        for name, formula in formulas.items():
            for window in WINDOWS:
                row = {"kind": kind, "formula": name, "window": window}
                row |= cost(formula, window, kind == "stream", given)
                rows.append(row)
                print(row, flush=True)
    given = samples(GROWTH)
    long = {
        f"{kind} {name}": growth(formulas[name], 100, kind == "stream", given)
        for kind, formulas, name in (("stream", STREAMS, "until"), ("monitor", MONITORS, "response"))
    }
    print(long)
    record = {"machine": describe("numpy"), "rows": rows, "growth": long}
    RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
