"""Mistakes of recordings, planted into the logs of healthy and of faulty machines: what the diagnosis says of them.

Run: python -m benchmarks.blind.mistakes [--cases 10] [--seed 6401] [--codes late scale] [--diagnose] [--write]

Each case is a machine of ``benchmarks/blind/emps`` or ``benchmarks/blind/turtlebot``, a twin whose laws are not the
simulator's; every second one has an effect or a cause outside the catalogue. Each code of a finding is planted in each
case once, with channels and sizes drawn at random. Printed for each code: how many are found with this code, how many
with any code, and with ``--diagnose`` how many give a wrong name with exit 0. ``clean`` are recordings without a
mistake, where every finding is false. Each answer is a file, so that a second call resumes.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from benchmarks.blind.development import RESULTS, axes, code_hash, simulator
from benchmarks.blind.emps.cases import plan, realise
from benchmarks.blind.outsiders.cases import make_case
from benchmarks.blind.scoring import MUST_NOT
from benchmarks.blind.turtlebot import machine as turtlebot
from s2r_spec.backend import Channel, load_backend
from s2r_spec.diagnose import diagnose
from s2r_spec.diagnose.quality import findings
from s2r_spec.diagnose.simulator.axes import effect_axes
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.effects import catalogue_of
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace

ROOT = Path(__file__).parents[2]
SPECS = {"axis": ROOT / "specs" / "emps_tracking.stl", "turtlebot": ROOT / "specs" / "turtlebot.stl"}
KINDS = ("null", "single", "null", "unknown")
"""Definition: kinds of the cases, in turn."""
GROUPS = {
    "axis": (("q", "v"), ("u", "force"), ("q_ref",), ("q",), ("u",)),
    "turtlebot": (("x", "y", "heading", "d_goal", "d_obs"), ("v", "w"), ("x", "y"), ("heading",), ("w",)),
}
"""Definition: channels that one instrument or one program records, and that share its clock."""
FORGOTTEN = {
    "m": (1e3, 1e2),
    "rad": (180.0 / np.pi,),
    "m/s": (1e3, 1e2),
    "rad/s": (180.0 / np.pi,),
    "V": (1e3,),
    "N": (1e-3,),
}
"""Definition: unit → factors of a forgotten one."""

Runs = list[tuple[dict[str, float], Trace]]
Spoil = Callable[[str, Runs, Generator], Runs]


@cache
def bench(machine: str) -> Bench:
    """Return the simulator of a machine with its specification."""
    spec = load_spec(SPECS[machine])
    return Bench.of(spec, spec.requirements[0], load_backend(simulator(machine)))


def channels(machine: str) -> Sequence[Channel]:
    """Return the channels of a machine."""
    return bench(machine).backend.channels


def changed(runs: Runs, names: Sequence[str], change: Callable[[Trace, np.ndarray], np.ndarray]) -> Runs:
    """Return recordings whose channels of these names are changed."""
    return [
        (test, trace.with_channels(lambda n, x, t=trace: change(t, x) if n in names else x))
        for test, trace in runs
    ]


def read_at(times: Callable[[np.ndarray], np.ndarray]) -> Callable[[Trace, np.ndarray], np.ndarray]:
    """Return a change that reads a channel at other times; before and after the recording it keeps its value."""
    return lambda trace, x: np.interp(times(trace.times), trace.times, x)


def some(machine: str, rng: Generator) -> tuple[str, ...]:
    """Draw a group of channels."""
    return GROUPS[machine][int(rng.integers(len(GROUPS[machine])))]


def one(machine: str, rng: Generator) -> Channel:
    """Draw a channel."""
    return channels(machine)[int(rng.integers(len(channels(machine))))]


def reach(runs: Runs, name: str) -> float:
    """Return the range of a channel over all recordings."""
    return float(np.ptp(np.concatenate([trace[name] for _, trace in runs])))


def late(machine: str, runs: Runs, rng: Generator) -> Runs:
    step, ticks = np.diff(runs[0][1].times[:2])[0], rng.uniform(2.0, 15.0)
    by = step * (round(ticks) if rng.random() < 0.5 else ticks)
    return changed(runs, some(machine, rng), read_at(lambda t: t - by))


def begin(machine: str, runs: Runs, rng: Generator) -> Runs:
    by = runs[0][1].duration * rng.uniform(0.01, 0.1) * rng.choice((-1.0, 1.0))
    return changed(runs, [c.name for c in channels(machine)], read_at(lambda t: t - by))


def clock(machine: str, runs: Runs, rng: Generator) -> Runs:
    factor = float(rng.choice((0.5, 0.8, 0.9, 0.95, 1.05, 1.1, 1.25, 2.0)))
    return changed(runs, [c.name for c in channels(machine)], read_at(lambda t: factor * t))


def hold(machine: str, runs: Runs, rng: Generator) -> Runs:
    each = int(rng.integers(4, 16))
    return changed(runs, some(machine, rng), lambda t, x: x[np.arange(len(x)) // each * each])


def exchanged(machine: str, runs: Runs, rng: Generator) -> Runs:
    known = channels(machine)
    pairs = [(a.name, b.name) for a in known for b in known if a.name < b.name and a.unit == b.unit]
    if machine == "axis":
        pairs.append(("u", "force"))
    a, b = pairs[int(rng.integers(len(pairs)))]
    other = {a: b, b: a}
    return [(t, x.with_channels(lambda n, v, x=x: x[other.get(n, n)])) for t, x in runs]


def sign(machine: str, runs: Runs, rng: Generator) -> Runs:
    signed = [c.name for c in channels(machine) if not c.name.startswith("d_")]
    group = [signed[int(rng.integers(len(signed)))]]
    return changed(runs, ("y", "heading", "w") if "y" in group else group, lambda t, x: -x)


def scale(machine: str, runs: Runs, rng: Generator) -> Runs:
    by = 1.0 + rng.uniform(0.03, 0.2) * rng.choice((-1.0, 1.0))
    group = some(machine, rng)
    unit = {c.name: c.unit for c in channels(machine)}
    return changed(runs, [n for n in group if unit[n] == unit[group[0]]], lambda t, x: by * x)


def frame(machine: str, runs: Runs, rng: Generator) -> Runs:
    angle = rng.uniform(0.05, 0.4) * rng.choice((-1.0, 1.0))
    c, s = np.cos(angle), np.sin(angle)

    def turned(trace: Trace) -> Trace:
        x, y = (trace[n] - trace[n][0] for n in "xy")
        new = {
            "x": trace["x"][0] + c * x - s * y,
            "y": trace["y"][0] + s * x + c * y,
            "heading": trace["heading"] + angle,
        }
        return trace.with_channels(lambda n, values: new.get(n, values))

    return [(test, turned(trace)) for test, trace in runs]


def offset(machine: str, runs: Runs, rng: Generator) -> Runs:
    name = one(machine, rng).name
    by = reach(runs, name) * rng.uniform(0.05, 0.3) * rng.choice((-1.0, 1.0))
    return changed(runs, [name], lambda t, x: x + by)


def labels(machine: str, runs: Runs, rng: Generator) -> Runs:
    tests, kind = [dict(test) for test, _ in runs], int(rng.integers(4))
    first, last = sorted(rng.choice(len(runs), 2, replace=False).tolist())
    if kind == 0:  # a line was entered twice
        tests = [*tests[: first + 1], *tests[first:-1]]
    elif kind == 1:  # a line is missing
        tests = [*tests[:first], *tests[first + 1 :], tests[first]]
    elif kind == 2:  # lines in another order
        tests = [tests[k] for k in rng.permutation(len(tests))]
    elif machine == "turtlebot":
        tests = [{**test, "ox": -test["ox"]} for test in tests]
    else:
        tests[first], tests[last] = tests[last], tests[first]
    return [(test, trace) for test, (_, trace) in zip(tests, runs, strict=True)]


def still(machine: str, runs: Runs, rng: Generator) -> Runs:
    return changed(runs, [one(machine, rng).name], lambda t, x: np.full_like(x, x[0]))


def wrapped(machine: str, runs: Runs, rng: Generator) -> Runs:
    return changed(runs, ["heading"], lambda t, x: np.mod(x, 2.0 * np.pi))


def unit(machine: str, runs: Runs, rng: Generator) -> Runs:
    channel = one(machine, rng)
    factor = float(rng.choice(FORGOTTEN[channel.unit]))
    return changed(runs, [channel.name], lambda t, x: factor * x)


def unit_of_one(machine: str, runs: Runs, rng: Generator) -> Runs:
    return in_one(runs, rng, lambda run: unit(machine, run, rng))


def in_one(runs: Runs, rng: Generator, spoil: Callable[[Runs], Runs]) -> Runs:
    """Return recordings one of which is spoiled."""
    k = int(rng.integers(len(runs)))
    return [*runs[:k], *spoil(runs[k : k + 1]), *runs[k + 1 :]]


def spike(machine: str, runs: Runs, rng: Generator) -> Runs:
    name = one(machine, rng).name
    by, at = reach(runs, name) * rng.uniform(0.3, 1.0) * rng.choice((-1.0, 1.0)), rng.uniform(0.1, 0.7)
    return in_one(
        runs,
        rng,
        lambda run: changed(run, [name], lambda t, x: x + by * (np.arange(len(x)) == int(at * len(x)))),
    )


def stopped(machine: str, runs: Runs, rng: Generator) -> Runs:
    name, since, part = one(machine, rng).name, rng.uniform(0.1, 0.3), rng.uniform(0.3, 0.6)
    return in_one(
        runs,
        rng,
        lambda run: changed(
            run,
            [name],
            lambda t, x: x[
                np.where(
                    (np.arange(len(x)) > since * len(x)) & (np.arange(len(x)) < (since + part) * len(x)),
                    int(since * len(x)),
                    np.arange(len(x)),
                )
            ],
        ),
    )


def copied(machine: str, runs: Runs, rng: Generator) -> Runs:
    k = int(rng.integers(len(runs)))
    other = int(rng.choice([j for j, (test, _) in enumerate(runs) if test != runs[k][0]]))
    return [*runs[:k], (runs[k][0], runs[other][1]), *runs[k + 1 :]]


CODES: Mapping[str, Spoil] = {
    "clean": lambda machine, runs, rng: runs,
    **{
        f.__name__.replace("_", " "): f
        for f in (late, begin, clock, hold, exchanged, sign, scale, frame, offset)
    },
    **{
        f.__name__.replace("_", " "): f
        for f in (labels, still, wrapped, unit, unit_of_one, spike, stopped, copied)
    },
}
"""Definition: code of a finding → how it is planted. The axis has no angles, so neither frames nor turns."""
WITHOUT = {"axis": ("frame", "wrapped"), "turtlebot": ()}


@cache
def recorded(machine: str, seed: int, number: int) -> tuple[Runs, Mapping[str, Any]]:
    """Return the recordings of a case, and its label."""
    rng, kind = np.random.default_rng([seed, number]), KINDS[number % len(KINDS)]
    case = realise([plan(rng, kind, 30)])[0] if machine == "axis" else make_case(turtlebot, rng, kind)
    return case.rollouts, case.label


def answer(machine: str, seed: int, number: int, code: str, cache: Path | None) -> dict[str, Any]:
    """Return what is said of one case with one mistake; with a cache, names where nothing is found."""
    runs, label = recorded(machine, seed, number)
    draws = np.random.default_rng([seed, number, sorted(CODES).index(code)])
    spoiled, began = CODES[code](machine, list(runs), draws), time.process_time()
    found = findings(bench(machine), spoiled, effect_axes(catalogue_of(bench(machine).backend)))
    out: dict[str, Any] = {
        "kind": label["kind"],
        "found": [[one.code, one.channel, one.text] for one in found],
        "seconds": round(time.process_time() - began, 2),
    }
    if cache is not None and not found:
        judged = diagnose(
            SPECS[machine], bench(machine).backend, spoiled, where=False, passive=True, cache=cache
        )
        out["names"], out["exit"] = list(judged.which.answer), judged.exit_code
        out["wrong"] = [name for name in judged.which.answer if absent(machine, label, name)]
    return out


def absent(machine: str, label: Mapping[str, Any], name: str) -> bool:
    """Return whether a machine has less of an effect than may be named."""
    values, (axis, *_) = {**label["background"], **label["effects"]}, axes(machine)[name]
    return name not in values or abs(axis.coordinate(values[name][axis.parameter])) < MUST_NOT


def table(answers: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Return machine and code → counts."""
    out: dict[str, dict[str, Any]] = {}
    for (machine, code), each in answers.items():
        row = {
            "cases": len(each),
            "found": sum(code in [f[0] for f in one["found"]] for one in each),
            "any finding": sum(bool(one["found"]) for one in each),
        }
        if any("exit" in one or one["found"] for one in each):
            row["wrong name, exit 0"] = sum(bool(one.get("wrong")) and one["exit"] == 0 for one in each)
        out.setdefault(machine, {})[code] = row
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machines", nargs="+", default=list(SPECS), choices=list(SPECS))
    parser.add_argument("--codes", nargs="+", default=list(CODES), choices=list(CODES))
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--seed", type=int, default=6401)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "s2r-mistakes")
    parser.add_argument("--diagnose", action="store_true", help="diagnose where nothing was found")
    parser.add_argument("--write", action="store_true", help="keep the counts in results/")
    given = parser.parse_args()
    folder = given.folder / f"{given.seed}-{code_hash()}"
    folder.mkdir(parents=True, exist_ok=True)
    answers: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for number in range(given.cases):
        for machine in given.machines:
            for code in (code for code in given.codes if code not in WITHOUT[machine]):
                path = folder / f"{machine}-{number:03d}-{code.replace(' ', '_')}.json"
                judged = json.loads(path.read_text()) if path.exists() else {}
                if not judged or (given.diagnose and not judged["found"] and "exit" not in judged):
                    judged = answer(
                        machine, given.seed, number, code, given.folder if given.diagnose else None
                    )
                    path.write_text(json.dumps(judged))
                    print(machine, number, code, judged, file=sys.stderr, flush=True)
                answers.setdefault((machine, code), []).append(judged)
    result = {"seed": given.seed, "cases": given.cases, "counts": table(answers)}
    print(json.dumps(result, indent=1))
    if given.write:
        (RESULTS / "mistakes.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
