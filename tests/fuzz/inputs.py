"""Inputs of ``python -m tests.fuzz``: a folder and a command line for each number, and what must come of it."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import s2r_spec as s2r
from tests.fuzz.mutators import damage

SPEC = """\
signal vx {m/s}
signal u[2]
param  vd {m/s} in [-0.2, 0.3]
const  tol = 0.1 {m/s}
let near := abs(vx - vd) <= tol
require walking: always[0.1 s, 0.6 s] near
require calm: always (norm(u) <= 4) and eventually[0, 0.5 s] (u[0] >= -3)
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""
ONE = "\n".join(line for line in SPEC.splitlines() if "calm" not in line and "u[2]" not in line) + "\n"
FORMATS = ("csv", "npz", "parquet")
TESTS = (-0.2, -0.1, 0.0, 0.1, 0.2, 0.3) * 2
TIMES = np.arange(11) / 10


@dataclass(frozen=True)
class Input:
    """A command in a folder.

    Attributes:
        kind: of the input, for the count.
        words: of the command line, after ``s2r``.
        what: what was done, in words.
        same_as: words of a command in the same folder whose verdicts must be the same; () if there is none.
    """

    kind: str
    words: tuple[str, ...]
    what: str
    same_as: tuple[str, ...] = ()


def prepare(folder: Path) -> None:
    """Write what inputs are copied from: a specification, traces of every format, two folders of logs, a run."""
    rng = np.random.default_rng(0)
    (folder / "spec.stl").write_text(SPEC)
    (folder / "one.stl").write_text(ONE)
    for name in FORMATS:
        s2r.write_trace(_trace(0.1, rng), folder / f"trace.{name}")
    for side in ("log", "sim"):
        logs = folder / side
        logs.mkdir()
        rows = ["id,vd [m/s]"]
        for number, value in enumerate(TESTS):
            rows.append(f"r{number},{value}")
            s2r.write_trace(_trace(value, rng), logs / f"r{number}.{FORMATS[number % 3]}")
        (logs / "rollouts.csv").write_text("\n".join(rows) + "\n")
    s2r.check(s2r.load_spec(folder / "one.stl"), f"log:{folder / 'log'}", folder / "run" / "walking")


def _trace(vd: float, rng: np.random.Generator) -> s2r.Trace:
    n = len(TIMES)
    channels = {"vx": vd + 0.01 * rng.normal(size=n), "u": rng.integers(-4, 5, (n, 2)) / 2}
    return s2r.Trace(TIMES, channels, {"vx": "m/s"})


def _copied(ready: Path, folder: Path, *names: str) -> None:
    for name in names:
        place = ready / name
        if place.is_dir():
            shutil.copytree(place, folder / name)
        else:
            shutil.copy(place, folder / name)


def spec(ready: Path, folder: Path, rng: random.Random) -> Input:
    """A damaged specification, or a drawn one, with a good trace."""
    trace = f"trace.{rng.choice(FORMATS)}"
    _copied(ready, folder, "spec.stl", trace)
    if rng.random() < 0.5:
        (folder / "spec.stl").write_text(drawn_spec(rng))
        what = "a drawn specification"
    else:
        what = "; ".join(
            damage(folder / "spec.stl", rng)
            for _ in range(rng.randrange(1, 3))
            if _is_file(folder / "spec.stl")
        )
    words = rng.choice(
        (
            ("monitor", "spec.stl", trace, "-p", "vd=0.1", "--json"),
            ("monitor", "spec.stl", trace, "-p", "vd=0.1"),
            ("monitor", "spec.stl", trace, "-p", "vd=0.1", "--online"),
            ("lint", "spec.stl", "--json"),
            ("fmt", "--check", "spec.stl"),
            ("fmt", "--to", "latex", "spec.stl"),
        )
    )
    return Input("spec", words, what)


def trace(ready: Path, folder: Path, rng: random.Random) -> Input:
    """A damaged trace with a good specification."""
    name = f"trace.{rng.choice(FORMATS)}"
    _copied(ready, folder, "spec.stl", name)
    what = "; ".join(
        damage(folder / name, rng) for _ in range(rng.randrange(1, 3)) if _is_file(folder / name)
    )
    found = [path.name for path in folder.iterdir() if path.name != "spec.stl"] or [name]
    more = rng.choice(
        ((), ("--json",), ("--online",), ("--partial",), ("--time-unit", "ms"), ("--nan", "hold"))
    )
    return Input("trace", ("monitor", "spec.stl", "-p", "vd=0.1", *more, "--", *sorted(found)[:1]), what)


def logs(ready: Path, folder: Path, rng: random.Random) -> Input:
    """A damaged folder of logs."""
    _copied(ready, folder, "one.stl", "log")
    what = _damaged_in(folder / "log", rng)
    if rng.random() < 0.3:
        _copied(ready, folder, "sim")
        return Input(
            "log folder",
            ("gap", "one.stl", "--sim", "log:sim", "--real", "log:log", "-q", "--run", "run"),
            what,
        )
    return Input("log folder", ("check", "one.stl", "-b", "log:log", "-q", "--run", "run", "--json"), what)


def run(ready: Path, folder: Path, rng: random.Random) -> Input:
    """A damaged run, its journal above all."""
    _copied(ready, folder, "run", "one.stl", "log")
    inside = folder / "run" / "walking"
    what = damage(inside / "journal.jsonl", rng) if rng.random() < 0.7 else _damaged_in(inside, rng)
    words = rng.choice(
        (
            ("report", "run"),
            ("replay", "run/walking#0.0"),
            ("odds", "run", "--B", "0.5", "--json"),
            ("check", "one.stl", "-b", "log:log", "-q", "--resume", "run"),
            ("choose", "run", "run"),
        )
    )
    return Input("run folder", words, what)


def _damaged_in(folder: Path, rng: random.Random) -> str:
    done = []
    for _ in range(rng.randrange(1, 4)):
        files = sorted(path for path in folder.rglob("*") if _is_file(path))
        if files:
            done.append(damage(rng.choice(files), rng))
    return "; ".join(done)


def _is_file(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def same(ready: Path, folder: Path, rng: random.Random) -> Input:
    """Two ways of writing one trace, whose verdicts must be the same."""
    generator = np.random.default_rng(rng.randrange(2**32))
    n = rng.randrange(3, 30)
    # in eighths, so that no unit and no format rounds them
    times = np.arange(n) / 8
    channels = {
        "vx": generator.integers(-16, 17, n) / 8,
        "w": generator.integers(-16, 17, n) / 8,
        "u": generator.integers(-16, 17, (n, 2)) / 8,
    }
    (folder / "spec.stl").write_text(drawn_spec(rng, exact=True))
    s2r.write_trace(s2r.Trace(times, channels, {"vx": "m/s"}), folder / "plain.npz")
    way = rng.choice(sorted(WAYS))
    words = WAYS[way](times, channels, folder, rng)
    ask = ("monitor", "spec.stl", "-p", "vd=0.125", "--partial", "--json")
    return Input("same verdict", (*ask, *words), way, (*ask, "plain.npz"))


Channels = dict[str, np.ndarray]
Way = Callable[[np.ndarray, Channels, Path, random.Random], tuple[str, ...]]


def _table(
    folder: Path, columns: list[tuple[str, list[str]]], end: str = "\n", mark: str = ""
) -> tuple[str, ...]:
    rows = [[name for name, _ in columns], *zip(*(values for _, values in columns), strict=True)]
    text = mark + end.join(",".join(row) for row in rows) + end
    (folder / "other.csv").write_bytes(text.encode())
    return ("other.csv",)


def _columns(
    times: np.ndarray, channels: Channels, time: str = "t [s]", scale: float = 1.0
) -> list[tuple[str, list[str]]]:
    numbers = [(time, times * scale), ("vx [m/s]", channels["vx"]), ("w", channels["w"])]
    numbers += [(f"u[{k}]", channels["u"][:, k]) for k in range(2)]
    return [(name, [repr(float(value)) for value in values]) for name, values in numbers]


def _unused(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    columns = _columns(times, channels)
    columns.insert(
        rng.randrange(1, len(columns) + 1), ("note", [rng.choice(("ok", "", "nan", "1")) for _ in times])
    )
    return _table(folder, columns)


def _permuted(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    columns = _columns(times, channels)
    rng.shuffle(columns)
    return _table(folder, columns)


def _renamed(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    columns = [(name.replace("vx", "speed"), values) for name, values in _columns(times, channels)]
    return (*_table(folder, columns), "--map", "vx=speed")


def _unit(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    unit, scale = rng.choice((("ms", 1e3), ("us", 1e6), ("ns", 1e9)))
    return _table(folder, _columns(times, channels, f"t [{unit}]", scale))


def _option(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    return (*_table(folder, _columns(times, channels, "t", 1e3)), "--time-unit", "ms")


def _lines(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    return _table(folder, _columns(times, channels), rng.choice(("\r\n", "\n")), rng.choice(("", "\ufeff")))


def _frame(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    s2r.write_trace(s2r.Trace(times, channels, {"vx": "m/s"}), folder / "other.parquet")
    return ("other.parquet",)


def _text(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    s2r.write_trace(s2r.Trace(times, channels, {"vx": "m/s"}), folder / "other.csv")
    return ("other.csv",)


def _split(times: np.ndarray, channels: Channels, folder: Path, rng: random.Random) -> tuple[str, ...]:
    columns = [
        (name.replace("[0]", "_0").replace("[1]", "_1"), values) for name, values in _columns(times, channels)
    ]
    return (*_table(folder, columns), "--map", "u[0]=u_0", "--map", "u[1]=u_1")


WAYS: dict[str, Way] = {
    "an unused column of text": _unused,
    "columns in another order": _permuted,
    "a column of another name, mapped": _renamed,
    "times in the unit of their header": _unit,
    "times in the unit of the option": _option,
    "other ends of lines": _lines,
    "Parquet": _frame,
    "CSV": _text,
    "components of other names, mapped": _split,
}


def drawn_spec(rng: random.Random, exact: bool = False) -> str:
    """Return a specification by the grammar; with ``exact`` only of what no rounding touches."""
    head = SPEC.split("const")[0] + "signal w\n" if exact else SPEC.split("require")[0]
    return head + "".join(
        f"require r{k}: {_formula(rng, rng.randrange(1, 5), exact)}\n" for k in range(rng.randrange(1, 3))
    )


def _formula(rng: random.Random, depth: int, exact: bool) -> str:
    if depth == 0:
        sign = rng.choice(("<=", ">=", "<", ">", "==", "!="))
        return f"({_number(rng, 2, exact)} {sign} {_number(rng, 1, exact)})"
    inner = [_formula(rng, depth - 1, exact) for _ in range(2)]
    match rng.randrange(6):
        case 0:
            return f"(not {inner[0]})"
        case 1:
            return f"({inner[0]} {rng.choice(('and', 'or', '->', '<->'))} {inner[1]})"
        case 2:
            word = rng.choice(("until", "since", "release", "unless"))
            return f"({inner[0]} {word}{_interval(rng, exact)} {inner[1]})"
        case 3:
            return f"({rng.choice(('next', 'prev'))} {inner[0]})"
        case _:
            word = rng.choice(("always", "eventually", "historically", "once"))
            return f"({word}{_interval(rng, exact)} {inner[0]})"


def _interval(rng: random.Random, exact: bool) -> str:
    if rng.random() < 0.3:
        return ""
    low = rng.randrange(4) / 8
    high = rng.choice((low, low + 0.125, low + 0.5, low + 2.0))
    return (
        f"[{low} s, {high} s]"
        if exact or rng.random() < 0.9
        else rng.choice(("[0, inf)", "(0, 1 ms)", "[1e-9, 1e9]"))
    )


def _number(rng: random.Random, depth: int, exact: bool) -> str:
    if depth == 0 or rng.random() < 0.4:
        # u has no unit; plain numbers go with anything
        return rng.choice(
            ("u[0]", "u[1]", "0", "0.5", "-1", *(("w",) if exact else ("norm(u)", "1e308", "sqrt(u[0])")))
        )
    a, b = _number(rng, depth - 1, exact), _number(rng, depth - 1, exact)
    more = () if exact else (f"({a} / {b})", f"({a}) ^ 2", f"deriv({a})", f"mean({a}, 0.2 s)")
    return rng.choice(
        (
            f"({a} + {b})",
            f"({a} - {b})",
            f"({a} * {b})",
            f"abs({a})",
            f"min({a}, {b})",
            f"max({a}, {b})",
            *more,
        )
    )


KINDS: dict[str, Callable[[Path, Path, random.Random], Input]] = {
    "spec": spec, "trace": trace, "logs": logs, "run": run, "same": same,
}  # fmt: skip
