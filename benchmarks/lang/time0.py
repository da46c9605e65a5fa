"""What ρ at time 0 costs on a long trace, beside ρ at every sample and beside sentil, a monitor in Rust.

    OMP_NUM_THREADS=1 python -m benchmarks.lang.time0

A trace has 1e5 samples at 1 kHz, and was read before: its clock and its NaN are checked once. A time is the least of
50 calls [ms]. sentil is left out where it is not installed (pip install sentil). Writes results/time0.json.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.a1.gaps import step_of_the_a1
from benchmarks.machine import describe
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace

try:
    import sentil
except ImportError:
    sentil = None

RESULTS = Path(__file__).parents[1] / "results" / "time0.json"
COUNT, PERIOD, CALLS = 100_000, 0.001, 50
FORMULAS = {
    "always": ("always[0, 10] (x <= 2)", "G[0,10] (x <= 2)"),
    "always eventually": ("always[0, 10] eventually[0, 2] (x > 0.5)", "G[0,10] (F[0,2] (x > 0.5))"),
    "until": ("x > -9 until[0, 10] y > 0.9", "(x > -9) U[0,10] (y > 0.9)"),
}
"""Name → the formula for s2r, and the same for sentil."""


def least(call: Callable[[], object]) -> float:
    """Return the least time of a call [ms]."""
    times = []
    for _ in range(CALLS):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return 1e3 * min(times)


def main() -> None:
    """Print one row a formula, and write all of them."""
    rng, times = np.random.default_rng(0), PERIOD * np.arange(COUNT)
    x, y = (wave + 0.1 * rng.normal(size=COUNT) for wave in (np.sin(times), np.cos(0.7 * times)))
    trace = Trace(times, {"x": x, "y": y})
    rows = []
    for name, (own, other) in FORMULAS.items():
        spec = parse_spec(f"signal x signal y require it: {own}")
        row = {
            "formula": name,
            "ms at time 0": least(lambda spec=spec: spec.robustness(trace)),
            "ms at every sample": least(lambda spec=spec: spec.evaluate(trace, "it")),
            "rho": spec.robustness(trace)["it"],
        }
        if sentil:
            monitor, given = sentil.Monitor(other), sentil.Trace(times, {"x": x, "y": y})
            row["ms of sentil"] = least(lambda monitor=monitor, given=given: monitor.robustness(given))
            row["rho of sentil"] = float(monitor.robustness(given))
        rows.append(
            {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}
        )
        print(rows[-1])
    record = {
        "machine": describe("numpy"),
        "a MuJoCo step of the A1 [us]": round(step_of_the_a1(), 1),
        "rows": rows,
    }
    RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
