"""How long ρ of a whole trace takes here, beside a C-speed window filter and the monitors that are installed.

    python benchmarks/language_speed.py

(a) always[0,1] x <= 1   (b) always[0,100] eventually[0,1] x > 0.5   (c) x > 0 until[0,5] y > 0
at 0.01 s a sample. "s2r" is Spec.robustness_signal with all its checks, "s2r kernels" the
windows alone, "s2r linear" the same in continuous time (as stlrom), "s2r torch" the forward pass,
"s2r backward" with the gradient of the sum of ρ at the first sample; other_monitors.py has the rest.

Each figure is the least time of up to 200 runs, on one thread; from 50 ms on it is processor time (which
ticks in 4 ms), so that what else the machine does counts little. Every tool runs in a child process
of 60 s and 8 GB; what took over 6 s is not tried on ten times the samples. What it returns is first held
against ρ here under its profile.
Writes language_speed.txt, .md and .svg; prints the table, and which targets are met.
"""

from __future__ import annotations

import json
import math
import os
import resource
import time
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253
from machine import describe
from other_monitors import MONITORS, PERIOD, Run, nothing
from scipy.ndimage import minimum_filter1d  # noqa: TID253

from s2r_spec.robustness.kernels import until, window_max, window_min
from s2r_spec.robustness.profiles import profile
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace

FORMULAS = {
    "a": "always[0, {w}] (x <= 1)",
    "b": "always[0, {w100}] eventually[0, {w}] (x > 0.5)",
    "c": "x > 0 until[0, {w}] y > 0",
}
WINDOW = {"a": 1.0, "b": 1.0, "c": 5.0}
SIZES = [(10**k,) for k in (3, 4, 5, 6)]
BATCH = (1000, 1501)
WINDOWS, LENGTH = [0.1, 1.0, 10.0, 50.0], (10_000,)  # how cost grows with the window
LIMIT, GIVE_UP, MEMORY = 60, 6.0, 8 * 2**30
TICKS = 0.05  # the processor clock is coarse: below this the wall clock is used [s]
SINGLE = 1e-5  # what is computed in single precision may differ by this

Signals = tuple[np.ndarray, np.ndarray]


def spec_of(formula: str, window: float) -> Any:
    text = FORMULAS[formula].format(w=window, w100=100 * window)
    return parse_spec(f"signal x signal y require it: {text}")


@cache
def signals(shape: tuple[int, ...]) -> Signals:
    x, y = np.random.default_rng(0).normal(size=(2, *shape))
    return x, y


def on_trace(like: str) -> Callable[..., Run | None]:
    def here(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run | None:
        if x.ndim > 1:
            return None
        spec, trace = spec_of(formula, window), Trace(np.arange(x.size) * PERIOD, {"x": x, "y": y})
        return nothing, lambda _: spec.robustness_signal(trace, "it", **profile(like)), like

    return here


def kernels(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run:
    w = round(window / PERIOD)
    run: Callable[[Any], Any] = {
        "a": lambda _: window_min(1 - x, 0, w),
        "b": lambda _: window_min(window_max(x - 0.5, 0, w), 0, 100 * w),
        "c": lambda _: until(x, y, 0, w),
    }[formula]
    return nothing, run, "s2r"


def c_filter(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run | None:
    w = round(window / PERIOD) + 1
    if formula == "c":
        return None
    if formula == "a":
        return nothing, lambda _: minimum_filter1d(1 - x, w, axis=-1), ""
    wide = 100 * (w - 1) + 1
    return nothing, lambda _: minimum_filter1d(minimum_filter1d(x - 0.5, w, axis=-1), wide, axis=-1), ""


def tensors(backward: bool) -> Callable[..., Run]:
    def here(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run:
        spec = spec_of(formula, window)

        def prepare() -> dict[str, torch.Tensor]:
            return {
                "x": torch.tensor(x, requires_grad=backward),
                "y": torch.tensor(y, requires_grad=backward),
            }

        def run(leaves: dict[str, torch.Tensor]) -> torch.Tensor:
            with torch.set_grad_enabled(backward):
                rho = spec.robustness_tensor(leaves, "it", period=PERIOD)
                if backward:
                    rho[..., 0].sum().backward()
            return (rho if rho.ndim == 1 else rho[0]).detach().numpy()

        return prepare, run, "s2r"

    return here


OURS = {
    "C window filter (scipy)": ("scipy", c_filter),
    "s2r kernels": ("s2r_spec", kernels),
    "s2r": ("s2r_spec", on_trace("s2r")),
    "s2r linear": ("s2r_spec", on_trace("stlrom")),
    "s2r torch": ("s2r_spec", tensors(backward=False)),
    "s2r backward": ("s2r_spec", tensors(backward=True)),
}
ROWS = {label: row for label, row in (OURS | MONITORS).items() if find_spec(row[0])}


def best(prepare: Callable[[], Any], run: Callable[[Any], Any], budget: float = 2.0) -> float:
    """Return the least time of up to 200 runs, or of what the budget allows [s]."""
    times: list[float] = []
    spent = 0.0
    while len(times) < 200 and spent < budget:
        inputs = prepare()
        start, processor = time.perf_counter(), time.process_time()
        run(inputs)
        processor, wall = time.process_time() - processor, time.perf_counter() - start
        times.append(wall if wall < TICKS else min(wall, processor))
        spent += times[-1]
    return min(times)


@cache
def expected(formula: str, window: float, shape: tuple[int, ...], like: str) -> np.ndarray:
    """Return ρ of the first trace along its time, by the package under a profile."""
    x, y = (np.atleast_2d(signal)[0] for signal in signals(shape))
    trace = Trace(np.arange(x.size) * PERIOD, {"x": x, "y": y})
    return spec_of(formula, window).robustness_signal(trace, "it", **profile(like))


def apart(answer: Any, reference: np.ndarray) -> float:
    """Return the greatest difference of an answer, at the start alone or along the trace."""
    found = np.atleast_2d(np.asarray(answer, dtype=float))[0]
    with np.errstate(invalid="ignore"):
        return float(
            np.where(found == reference[: found.size], 0.0, np.abs(found - reference[: found.size])).max()
        )


def cell(label: str, formula: str, window: float, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return what a child process measures: seconds and how far the answer is off, or why there is neither."""
    _, tool = ROWS[label]
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (LIMIT + int(time.process_time()),) * 2)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY,) * 2)
            found = _measured(tool, formula, window, shape)
        except (MemoryError, RuntimeError) as error:
            found = {
                "why": "memory"
                if "alloc" in str(error) or isinstance(error, MemoryError)
                else str(error)[:200]
            }
        os.write(writing, json.dumps(found).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    found = json.loads(text) if text else {"why": f"over {LIMIT} s"}
    return {"tool": label, "formula": formula, "window s": window, "shape": list(shape), **found}


def _measured(
    tool: Callable[..., Run | None], formula: str, window: float, shape: tuple[int, ...]
) -> dict[str, Any]:
    made = tool(formula, window, *signals(shape))
    if made is None:
        return {"why": "cannot"}
    prepare, run, like = made
    inputs = prepare()
    start = time.process_time()
    answer = run(inputs)
    first = time.process_time() - start
    seconds = first if first > 2 else best(prepare, run)
    off = apart(answer, expected(formula, window, shape, like)) if like else None
    return {"ms": float(f"{1e3 * seconds:.4g}"), "answer off by": off}


def measure() -> list[dict[str, Any]]:
    """Return every cell of the table, and then those of growing windows."""
    cells: list[dict[str, Any]] = []
    for formula, window in WINDOW.items():
        for label in ROWS:
            gave_up = False
            for shape in [*SIZES, BATCH]:
                own = label in OURS or label.startswith(("tidystl", "stlcgpp"))  # take a whole batch at once
                if gave_up and not (shape == BATCH and own):
                    continue
                cells.append(cell(label, formula, window, shape))
                print(cells[-1], flush=True)
                gave_up = cells[-1].get("ms", math.inf) > 1e3 * GIVE_UP and cells[-1].get("why") != "cannot"
    for formula in "ac":
        for label in ROWS:
            for window in WINDOWS:
                cells.append(cell(label, formula, window, LENGTH) | {"growth": "window"})
                print(cells[-1], flush=True)
                if cells[-1].get("ms", math.inf) > 1e3 * GIVE_UP:
                    break
    return cells


def parsing() -> float:
    """Return the time a line takes to parse and check, after warm-up [ms]."""
    text = "signal x\nparam p in [0, 1]\n" + "".join(
        f"let a{k} := always[0, {k + 1} s] (abs(x - p) <= {k} or x > {k})\n" for k in range(200)
    )
    text += "require it: a0"
    parse_spec(text)
    return 1e3 * best(nothing, lambda _: parse_spec(text)) / 203


def targets(cells: list[dict[str, Any]], per_line: float) -> list[str]:
    """Return a line for each target of the language: the figure, the target, whether it is met."""

    def ms(label: str, formula: str, shape: tuple[int, ...]) -> float:
        return next(
            one["ms"] for one in cells
            if (one["tool"], one["formula"], one["shape"]) == (label, formula, list(shape)) and "growth" not in one
        )  # fmt: skip

    found = [
        ("kernels, times the C filter, worst of (a), (b)", 2.0,
         max(ms("s2r kernels", f, s) / ms("C window filter (scipy)", f, s) for f in "ab" for s in [*SIZES, BATCH])),
        ("s2r at 1e3 samples, worst formula [ms]", 0.1, max(ms("s2r", f, SIZES[0]) for f in "abc")),
        ("s2r at 1e6 samples, worst formula [ms]", 200, max(ms("s2r", f, SIZES[-1]) for f in "abc")),
        ("s2r torch, 1000 x 1501, worst formula [ms]", 300, max(ms("s2r torch", f, BATCH) for f in "abc")),
        ("the same with backward [ms]", 1000, max(ms("s2r backward", f, BATCH) for f in "abc")),
        ("parsing a line [ms]", 1.0, per_line),
    ]  # fmt: skip
    return [
        f"{'met' if value <= most else 'NOT MET'}: {what}: {value:.3g}, at most {most:g}"
        for what, most, value in found
    ]


def table(cells: list[dict[str, Any]]) -> str:
    """Return the cells as Markdown, one table a formula."""
    lines = []
    for formula, window in WINDOW.items():
        text = FORMULAS[formula].format(w=f"{window:g}", w100=f"{100 * window:g}")
        lines += [
            "",
            f"**({formula})** `{text}`",
            "",
            "| | 1e3 | 1e4 | 1e5 | 1e6 | 1000×1501 |",
            "|" + " --- |" * 6,
        ]
        for label in ROWS:
            row = [
                next((_written(one) for one in cells if (one["tool"], one["formula"], one["shape"]) ==
                      (label, formula, list(shape)) and "growth" not in one), "(not tried)")
                for shape in [*SIZES, BATCH]
            ]  # fmt: skip
            lines.append(f"| {label} | " + " | ".join(row) + " |")
    return "\n".join(lines).strip()


def _written(one: dict[str, Any]) -> str:
    if "ms" not in one:
        return {"cannot": "–", "memory": "over 8 GB"}.get(one["why"], one["why"])
    ms = one["ms"]
    text = f"{1e3 * ms:.3g} µs" if ms < 1 else f"{ms:.3g} ms" if ms < 1e3 else f"{ms / 1e3:.3g} s"
    off = one["answer off by"]
    return text if off is None or off <= SINGLE else f"{text} †"


def plot(cells: list[dict[str, Any]], path: Path) -> None:
    """Draw cost over the number of samples and over the length of the window."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams |= {"svg.hashsalt": "s2r", "font.size": 8}
    import matplotlib.pyplot as plt

    shown = [label for label in ROWS if label not in ("s2r torch", "s2r backward", "stlcgpp backward")]
    colours = dict(zip(shown, plt.get_cmap("tab10").colors, strict=False))
    figure, axes = plt.subplots(1, 4, figsize=(15, 3.6), sharey=True, layout="constrained")
    panels = [("a", None), ("c", None), ("a", "window"), ("c", "window")]
    for ax, (formula, growth) in zip(axes, panels, strict=True):
        for label in shown:
            points = [
                (one["window s"] / PERIOD if growth else one["shape"][0], one["ms"] / 1e3)
                for one in cells
                if one["tool"] == label and one["formula"] == formula and one.get("growth") == growth
                and len(one["shape"]) == 1 and "ms" in one
            ]  # fmt: skip
            if points:
                ax.loglog(*zip(*points, strict=True), "o-", ms=3, lw=1, color=colours[label], label=label)
        name = {"a": "always[0, w] x ≤ 1", "c": "x > 0 until[0, w] y > 0"}[formula]
        ax.set_title(
            f"{name}, {LENGTH[0]:g} samples" if growth else f"{name}, w = {WINDOW[formula]:g} s", fontsize=8
        )
        ax.set_xlabel("samples in the window" if growth else "samples")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("processor time of ρ along the trace [s]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    torch.set_num_threads(1)
    for package, _ in ROWS.values():
        import_module("stlcgpp.formula" if package == "stlcgpp" else package)
    others = sorted({package for package, _ in MONITORS.values() if find_spec(package)})
    cells, per_line = measure(), parsing()
    record = {
        "machine": describe("numpy", "scipy", "torch", *others),
        "load of the machine": os.getloadavg(),
        "parsing ms per line": round(per_line, 3),
        "targets": targets(cells, per_line),
        "results": cells,
    }
    path = Path(__file__)
    head, tail = json.dumps(record | {"results": []}, indent=1).rsplit("[]", 1)
    rows = ",\n  ".join(json.dumps(one) for one in cells)
    path.with_suffix(".txt").write_text(f"{head}[\n  {rows}\n ]{tail}\n")
    path.with_suffix(".md").write_text(table(cells) + "\n", encoding="utf-8")
    plot(cells, path.with_suffix(".svg"))
    print(table(cells), *record["targets"], sep="\n")


if __name__ == "__main__":
    main()
