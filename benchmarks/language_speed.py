"""How long ρ of a whole trace takes, beside a C-speed window filter; RTAMT too where it is installed.

    python benchmarks/language_speed.py

(a) always[0,1] x <= 1   (b) always[0,100] eventually[0,1] x > 0.5   (c) x > 0 until[0,5] y > 0
at 0.01 s a sample. "spec" is Spec.robustness_signal with all its checks, "kernels" the
windows alone, "torch" the forward pass, "backward" with the gradient of the sum at the
first sample. Minimum of several runs, one thread.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch  # noqa: TID253
from machine import describe
from scipy.ndimage import minimum_filter1d  # noqa: TID253

from s2r_spec.robustness.kernels import until, window_max, window_min
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace

FORMULAS = {
    "a": "always[0, 1] (x <= 1)",
    "b": "always[0, 100] eventually[0, 1] (x > 0.5)",
    "c": "x > 0 until[0, 5] y > 0",
}
SIZES = [10**3, 10**4, 10**5, 10**6]
BATCH = (1000, 1501)


def best(run: Callable[[], object]) -> float:
    """Return the least time of up to 20 runs, or of what two seconds allow [s]."""
    run()
    times: list[float] = []
    while len(times) < 20 and sum(times) < 2:
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def kernels(name: str, x: np.ndarray, y: np.ndarray) -> Callable[[], object]:
    return {
        "a": lambda: window_min(1 - x, 0, 100),
        "b": lambda: window_min(window_max(x - 0.5, 0, 100), 0, 10_000),
        "c": lambda: until(x, y, 0, 500),
    }[name]


def c_filter(name: str, x: np.ndarray) -> Callable[[], object] | None:
    if name == "c":
        return None
    if name == "a":
        return lambda: minimum_filter1d(1 - x, 101, axis=-1)
    return lambda: minimum_filter1d(minimum_filter1d(x - 0.5, 101, axis=-1), 10_001, axis=-1)


def rtamt(name: str, n: int, x: np.ndarray) -> Callable[[], object] | None:
    if name != "a" or n > 10**5 or not find_spec("rtamt"):
        return None
    import rtamt as tool

    spec = tool.StlDiscreteTimeSpecification()
    spec.declare_var("x", "float")
    spec.set_sampling_period(10, "ms", 0.1)
    spec.spec = "always[0:1000ms](x <= 1)"
    spec.parse()
    data = {"time": (np.arange(n) * 0.01).tolist(), "x": x.tolist()}
    return lambda: spec.evaluate({key: list(values) for key, values in data.items()})


def measure(name: str, shape: tuple[int, ...]) -> dict[str, object]:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, *shape))
    spec = parse_spec(f"signal x signal y require it: {FORMULAS[name]}")
    row: dict[str, object] = {"formula": name, "shape": list(shape)}
    row["kernels ms"] = 1e3 * best(kernels(name, x, y))
    if (limit := c_filter(name, x)) is not None:
        row["scipy filter ms"] = 1e3 * best(limit)
    if len(shape) == 1:
        trace = Trace(np.arange(shape[0]) * 0.01, {"x": x, "y": y})
        row["spec ms"] = 1e3 * best(lambda: spec.robustness_signal(trace, "it"))
        if (other := rtamt(name, shape[0], x)) is not None:
            row["rtamt ms"] = 1e3 * best(other)
    tensors = {"x": torch.tensor(x), "y": torch.tensor(y)}
    with torch.no_grad():
        row["torch ms"] = 1e3 * best(lambda: spec.robustness_tensor(tensors, "it", period=0.01))
    leaves = {key: value.clone().requires_grad_() for key, value in tensors.items()}
    row["backward ms"] = 1e3 * best(
        lambda: spec.robustness_tensor(leaves, "it", period=0.01)[..., 0].sum().backward()
    )
    return {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}


def parsing() -> float:
    """Return the time a line takes to parse and check, after warm-up [ms]."""
    text = "signal x\nparam p in [0, 1]\n" + "".join(
        f"let a{k} := always[0, {k + 1} s] (abs(x - p) <= {k} or x > {k})\n" for k in range(200)
    )
    text += "require it: a0"
    return 1e3 * best(lambda: parse_spec(text)) / 203


def main() -> None:
    torch.set_num_threads(1)
    rows = [measure(name, shape) for name in FORMULAS for shape in [*((n,) for n in SIZES), BATCH]]
    record = {
        "machine": describe("numpy", "scipy", "torch"),
        "parsing ms per line": round(parsing(), 3),
        "results": rows,
    }
    text = json.dumps(record, indent=1)
    Path(__file__).with_suffix(".txt").write_text(text + "\n")
    for row in rows:
        print(row)
    print(record["parsing ms per line"], "ms per line parsed")


if __name__ == "__main__":
    main()
