"""Random formulas and traces, evaluated by other monitors and here under the profile of each.

    python -m benchmarks.lang.conventions [scale]

RTAMT gets all that both languages can say, the others what they have in common:
and, or, not, always, eventually, until, over x and y against a number. Each
other tool runs in a child process: STLRom dies of an until whose window goes past the end of
the trace (without an answer there). Tools that are not
installed are left out. Writes language_conventions.txt; ``scale`` shortens the run.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from fractions import Fraction
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from benchmarks.machine import describe
from s2r_spec.robustness.profiles import profile
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.robustness import rtamt_runs
from tests.robustness.drawing import NUMBERS, text_of
from tests.robustness.rtamt_runs import Pair, pairs

TOLERANCE = 1e-9
_WITHIN = st.tuples(st.integers(0, 3), st.integers(1, 3)).map(lambda ends: (ends[0], sum(ends), True, True))
_COMMON = st.recursive(
    st.tuples(st.sampled_from(["<=", ">="]), st.sampled_from(["x", "y"]).map(lambda name: ("name", name)),
              NUMBERS.filter(lambda value: value >= 0).map(lambda value: ("num", value))),
    lambda inner: st.one_of(
        st.tuples(st.just("not"), inner),
        st.tuples(st.sampled_from(["and", "or"]), inner, inner),
        st.tuples(st.sampled_from(["always", "eventually"]), _WITHIN, inner),
        st.tuples(st.just("until"), _WITHIN, inner, inner),
    ),
    max_leaves=4,
)  # fmt: skip


@st.composite
def common(draw: st.DrawFn) -> Pair:
    n = draw(st.integers(5, 12))
    sample = st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=n, max_size=n).map(tuple)
    return Pair(draw(_COMMON), tuple(range(n)), draw(sample), draw(sample))


def rtamt_discrete(pair: Pair) -> list[float]:
    return rtamt_runs.in_discrete_time(rtamt_runs.written(pair.formula), pair.x, pair.y)


def rtamt_dense(pair: Pair) -> list[float]:
    return rtamt_runs.in_dense_time(rtamt_runs.written(pair.formula), pair.ticks, pair.x, pair.y)


def tidystl(pair: Pair) -> list[float]:
    from tidystl import Signal, parse, robustness

    def written(node: tuple) -> str:
        match node:
            case ("not", a):
                return f"(not {written(a)})"
            case (("and" | "or") as word, a, b):
                return f"({written(a)} {word} {written(b)})"
            case ("always" | "eventually", (low, high, *_), a):
                return f"({'G' if node[0] == 'always' else 'F'}[{low},{high}]({written(a)}))"
            case ("until", (low, high, *_), a, b):
                return f"({written(a)} U[{low},{high}] {written(b)})"
            case (sign, (_, name), (_, value)):
                return f"({name} {sign} {value})"
        raise AssertionError(node)

    signal = Signal.from_dict(np.array(pair.ticks, float), {"x": np.array(pair.x), "y": np.array(pair.y)})
    return robustness(parse(written(pair.formula)), signal)[0].tolist()


def stlrom(pair: Pair) -> list[float]:
    import stlrom as tool

    def written(node: tuple) -> str:
        match node:
            case ("not", a):
                return f"(not ({written(a)}))"
            case (("and" | "or") as word, a, b):
                return f"(({written(a)}) {word} ({written(b)}))"
            case ("always" | "eventually", (low, high, *_), a):
                return f"({'alw' if node[0] == 'always' else 'ev'}_[{low},{high}] ({written(a)}))"
            case ("until", (low, high, *_), a, b):
                return f"(({written(a)}) until_[{low},{high}] ({written(b)}))"
            case (sign, (_, name), (_, value)):
                return f"({name}[t] {sign} {value})"
        raise AssertionError(node)

    driver = tool.STLDriver()
    driver.parse_string(f"signal x, y\nphi := {written(pair.formula)}\n")
    driver.data = [[float(t), x, y] for t, x, y in zip(pair.ticks, pair.x, pair.y, strict=True)]
    monitor = driver.get_monitor("phi")
    return [monitor.eval_rob(float(t)) for t in pair.ticks]


def stlcgpp(pair: Pair) -> list[float]:
    import torch
    from stlcgpp import formula as tool

    places = {"x": lambda s: s[..., 0], "y": lambda s: s[..., 1]}

    def built(node: tuple):
        match node:
            case ("not", a):
                return tool.Negation(built(a))
            case ("and" | "or", a, b):
                return (tool.And if node[0] == "and" else tool.Or)(built(a), built(b))
            case ("always" | "eventually", (low, high, *_), a):
                kind = tool.Always if node[0] == "always" else tool.Eventually
                return kind(built(a), interval=[low, high])
            case ("until", (low, high, *_), a, b):
                return tool.Until(built(a), built(b), interval=[low, high])
            case (sign, (_, name), (_, value)):
                predicate = tool.Predicate(name, places[name])
                return predicate <= value if sign == "<=" else predicate >= value
        raise AssertionError(node)

    signal = torch.tensor(np.stack([pair.x, pair.y], axis=-1), dtype=torch.float32)
    return built(pair.formula)(signal, padding="last").tolist()


def shielded(run: Callable[[Pair], list[float]]) -> Callable[[Pair], list[float] | None]:
    """Return what runs a pair in a child process, and gives None where that dies or raises."""

    def there(pair: Pair) -> list[float] | None:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            silence = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silence, 1)
            os.dup2(silence, 2)
            try:
                os.write(writing, repr(run(pair)).encode())
            finally:
                os._exit(0)
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            text = pipe.read().decode()
        os.waitpid(child, 0)
        return eval(text, {"inf": np.inf, "nan": np.nan}) if text else None

    return there


TOOLS = {
    "rtamt": ("rtamt", rtamt_discrete, pairs(dense=False), 5_000),
    "rtamt-dense": ("rtamt", rtamt_dense, pairs(dense=True), 5_000),
    "stlrom": ("stlrom", shielded(stlrom), common(), 2_000),
    "stlcgpp": ("stlcgpp", shielded(stlcgpp), common(), 2_000),
    "tidystl": ("tidystl", shielded(tidystl), common(), 2_000),
}


def here(pair: Pair, name: str) -> np.ndarray:
    spec = parse_spec(f"signal x signal y require it: {text_of(pair.formula, Fraction(1, 10))}")
    trace = Trace(np.array(pair.ticks) * 0.1, {"x": pair.x, "y": pair.y})
    return spec.robustness_signal(trace, "it", **profile(name))


def compare(name: str, scale: float) -> dict[str, object]:
    package, run, drawn, count = TOOLS[name]
    import_module("stlcgpp.formula" if package == "stlcgpp" else package)  # once, not in every child
    tally = {
        "pairs": 0,
        "samples compared": 0,
        "pairs without an answer there": 0,
        "samples without an answer there": 0,
        "pairs that differ": 0,
    }
    worst, examples = 0.0, []

    @seed(0)
    @settings(max_examples=int(count * scale), database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(pair=drawn)
    def one(pair: Pair) -> None:
        nonlocal worst
        tally["pairs"] += 1
        answer = run(pair)
        if answer is None:
            tally["pairs without an answer there"] += 1
            return
        there, found = np.array(answer), here(pair, name)
        said = ~np.isnan(there)
        tally["samples compared"] += int(said.sum())
        tally["samples without an answer there"] += int((~said).sum())
        with np.errstate(invalid="ignore"):
            apart = float(np.where((found == there) | ~said, 0.0, np.abs(found - there)).max())
        worst = max(worst, apart)
        if not apart <= TOLERANCE:
            tally["pairs that differ"] += 1
            examples.append(
                {"formula": text_of(pair.formula, Fraction(1)), "x": pair.x, "y": pair.y, "there": answer,
                 "here": found.tolist()}
            )  # fmt: skip

    start = time.perf_counter()
    one()
    return {"profile": name, "tool": package, **tally, "greatest difference": worst,
            "shortest examples": sorted(examples, key=lambda one: len(one["formula"]))[:2],
            "seconds": round(time.perf_counter() - start)}  # fmt: skip


def main() -> None:
    scale = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    there = [name for name in ("rtamt", "stlrom", "stlcgpp", "tidystl") if find_spec(name)]
    results = []
    for name, (package, *_) in TOOLS.items():
        if package in there:
            results.append(compare(name, scale))
            print(json.dumps(results[-1], indent=1), flush=True)
    record = {"machine": describe("numpy", "hypothesis", *there), "results": results}
    text = json.dumps(record, indent=1, ensure_ascii=False)
    (Path(__file__).parents[1] / "results" / "language_conventions.txt").write_text(
        text + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
