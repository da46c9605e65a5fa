"""What robustness costs at time 0 and online, beside ρ at every sample and beside sentil, a monitor in Rust.

    OMP_NUM_THREADS=1 python -m benchmarks.lang.peers

At time 0: a trace of 1e5 samples at 1 kHz, which was read before; its clock and its NaN are checked once. Online: the
same samples in blocks of 1000 and one by one, ρ at every sample. A figure is the least of several runs; "one by one"
is a tenth of the samples. sentil is left out where it is not installed (pip install sentil). Writes results/peers.json.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.a1.gaps import step_of_the_a1
from benchmarks.machine import describe
from s2r_spec.base.arrays import FloatArray
from s2r_spec.spec import Spec, parse_spec
from s2r_spec.trace import Trace

try:
    import sentil
except ImportError:
    sentil = None

RESULTS = Path(__file__).parents[1] / "results" / "peers.json"
COUNT, PERIOD, BLOCK = 100_000, 0.001, 1000
FORMULAS = {
    "always": ("always[0, 10] (x <= 2)", "G[0,10] (x <= 2)"),
    "always eventually": ("always[0, 10] eventually[0, 2] (x > 0.5)", "G[0,10] (F[0,2] (x > 0.5))"),
    "until": ("x > -9 until[0, 10] y > 0.9", "(x > -9) U[0,10] (y > 0.9)"),
}
"""Name → the formula for s2r, and the same for sentil."""
ONLINE = {
    "always": ("always[0, 1] (x <= 2)", "G[0,1] (x <= 2)"),
    "always eventually": ("always[0, 1] eventually[0, 0.5] (x > 0.5)", "G[0,1] (F[0,0.5] (x > 0.5))"),
    "until": ("x > -9 until[0, 1] y > 0.9", "(x > -9) U[0,1] (y > 0.9)"),
}
Signals = dict[str, FloatArray]


def least(call: Callable[[], object], runs: int) -> float:
    """Return the least time of a call [s]."""
    times = []
    for _ in range(runs):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return min(times)


def at_time_0(times: FloatArray, signals: Signals) -> list[dict[str, object]]:
    """Return a row for each formula, in ms."""
    trace, rows = Trace(times, signals), []
    for name, (own, other) in FORMULAS.items():
        spec = spec_of(own)
        row = {
            "at time 0": name,
            "ms": 1e3 * least(lambda spec=spec: spec.robustness(trace), 50),
            "ms at every sample": 1e3 * least(lambda spec=spec: spec.evaluate(trace, "it"), 5),
            "rho": spec.robustness(trace)["it"],
        }
        if sentil:
            monitor, given = sentil.Monitor(other), sentil.Trace(times, signals)
            row["ms of sentil"] = 1e3 * least(lambda m=monitor, g=given: m.robustness(g), 20)
            row["rho of sentil"] = float(monitor.robustness(given))
        rows.append(printed(row))
    return rows


def online(times: FloatArray, signals: Signals) -> list[dict[str, object]]:
    """Return a row for each formula, in µs a sample."""
    few = COUNT // 10
    lists = {name: one[:few].tolist() for name, one in signals.items()}
    each = [(t, {name: one[k] for name, one in lists.items()}) for k, t in enumerate(times[:few].tolist())]
    rows = []
    for name, (own, other) in ONLINE.items():
        spec = spec_of(own)
        row = {
            "online": name,
            "us in blocks": 1e6 / COUNT * least(lambda s=spec: in_blocks(s, times, signals), 3),
            "us one by one": 1e6
            / few
            * least(lambda s=spec: one_by_one(s.robustness_stream(period=PERIOD), each), 3),
        }
        if sentil:
            row["us of sentil"] = (
                1e6 / few * least(lambda o=other: one_by_one(sentil.OnlineMonitor(o), each), 3)
            )
        rows.append(printed(row))
    return rows


def in_blocks(spec: Spec, times: FloatArray, signals: Signals) -> None:
    stream = spec.robustness_stream(period=PERIOD)
    for begin in range(0, COUNT, BLOCK):
        part = slice(begin, begin + BLOCK)
        stream.extend(times[part], {name: one[part] for name, one in signals.items()})


def one_by_one(monitor: object, samples: list[tuple[float, dict[str, float]]]) -> None:
    update = monitor.update
    for time, sample in samples:
        update(time, sample)


def spec_of(formula: str) -> Spec:
    return parse_spec(f"signal x signal y require it: {formula}")


def printed(row: dict[str, object]) -> dict[str, object]:
    row = {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}
    print(row, flush=True)
    return row


def main() -> None:
    """Print one row a formula, and write all of them."""
    rng, times = np.random.default_rng(0), PERIOD * np.arange(COUNT)
    waves = {"x": np.sin(times), "y": np.cos(0.7 * times)}
    signals = {name: wave + 0.1 * rng.normal(size=COUNT) for name, wave in waves.items()}
    rows = at_time_0(times, signals) + online(times, signals)
    step = round(step_of_the_a1(), 1)
    record = {"machine": describe("numpy"), "a MuJoCo step of the A1 [us]": step, "rows": rows}
    RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
