"""Does the range of `s2r plan` contain what complete runs take, and is the first estimate of what is left near it?

Runs `s2r check` on every shipped spec with a certify line, and on a tutorial's, with several seeds. Beside each number
of rollouts stands the plan's range. The first estimate is the one after the first batch. Its ratio to the truth is
given for rollouts and for seconds. Times depend on the machine, so the time of a MuJoCo step of the A1 stands beside
them. The A1 takes minutes for each seed; its earlier complete runs come from other committed results. ::

    OMP_NUM_THREADS=1 python -m benchmarks.certify.plan             # 7 minutes of one core
    OMP_NUM_THREADS=1 python -m benchmarks.certify.plan --a1 3      # and the A1, kept afterwards: 6 minutes
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.console import Console

import s2r_spec as s2r
from benchmarks.a1.gaps import step_of_the_a1
from benchmarks.machine import describe
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.from_spec import only_requirement, search_for
from s2r_spec.certify.options import RunOptions
from s2r_spec.certify.search.plan import rollouts
from s2r_spec.certify.search.search import Query
from s2r_spec.cli.terminal.progress import Live

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
SEEDS = range(6)
A1 = "specs/a1_velocity.stl"
TUTORIAL = ROOT / "docs" / "tutorials" / "gap-and-cause.md"


class Watch(Live):
    """Notes the estimates after the first batch, and the time at which they were made.

    Attributes:
        first: rollouts so far, rollouts left, seconds left, time.
    """

    def __init__(self) -> None:
        super().__init__(Console(file=StringIO()), quiet=False)
        self.first: tuple[int, int, float, float] | None = None

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        super().batch(queries, certificate)
        left, seconds = self._state.left(), self._state.seconds_left()
        if self.first is None and left is not None and seconds is not None:
            self.first = (certificate.rollouts, left, seconds, perf_counter())


@dataclass(frozen=True)
class Run:
    """One complete run.

    Attributes:
        stop: its stopping rule.
        rollouts: what it took.
        seconds: the time it took [s]; None for a run from another result.
        inside: whether the plan's range contains it; None under a rule without a plan.
        left_ratio: first estimate of the rollouts left, over the truth.
        seconds_ratio: the same of the seconds.
    """

    spec: str
    seed: int
    stop: str
    label: str
    rollouts: int
    seconds: float | None = None
    inside: bool | None = None
    left_ratio: float | None = None
    seconds_ratio: float | None = None


def complete(name: str, spec: s2r.Spec, backend: str, seed: int, stop: str, planned: tuple[int, int]) -> Run:
    """Run a check to its end."""
    watch, began = Watch(), perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        found = s2r.check(
            spec,
            backend,
            Path(folder) / "run",
            seed=seed,
            stop=stop,
            observer=watch,
            executor=partial(ThreadPoolExecutor, 1),
        ).certificate
    ended, ratios = perf_counter(), (None, None)
    if watch.first is not None:
        n, left, seconds, at = watch.first
        ratios = round(left / (found.rollouts - n), 2), round(seconds / (ended - at), 2)
    inside = planned[0] <= found.rollouts <= planned[1] if stop == "epsilon" else None
    run = Run(name, seed, stop, found.label.name, found.rollouts, round(ended - began, 1), inside, *ratios)
    print(f"{run}", flush=True)
    return run


def earlier(planned: tuple[int, int], output: Path) -> list[Run]:
    """Return the complete runs of the A1's spec that other results have, and earlier ones of this file."""
    readme = json.loads((RESULTS / "readme_certify.json").read_text())["result"]["simulation"]["search"]
    counts = {0: readme["rollouts"]}
    repeated = json.loads((ROOT / "benchmarks/paper/results/repeatability.json").read_text())
    for run in repeated["complete_runs"]:
        counts[run["settings"]["seed"]] = run["rollouts"]
    before = json.loads(output.read_text())["runs"] if output.exists() else []
    kept = [Run(**run) for run in before if run["spec"] == A1 and run["seconds"] is not None]
    return kept + [
        Run(
            A1,
            seed,
            "epsilon",
            "CERTIFIED",
            count,
            inside=planned[0] <= count <= planned[1],
        )
        for seed, count in counts.items()
    ]


def tutorial() -> s2r.Spec:
    """Return the specification of the tutorial on the gap and its cause."""
    (text,) = re.findall(r"```stl\n(.*?)```", TUTORIAL.read_text(), re.S)
    return s2r.parse_spec(text, "drive.stl")


def planned_of(spec: s2r.Spec) -> tuple[tuple[int, int], float]:
    """Return the plan's range of rollouts, and the time of the estimate [s]."""
    settings = search_for(spec, only_requirement(spec), RunOptions()).settings
    began = perf_counter()
    low, high = rollouts(settings)
    return (round(low), round(high)), perf_counter() - began


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all, print a line for each run and each spec, write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--a1", type=int, nargs="*", default=[], help="seeds of the A1's spec to run, too")
    parser.add_argument("--output", type=Path, default=RESULTS / "plan_calibration.json")
    options = parser.parse_args(arguments)
    step = step_of_the_a1()
    cases: dict[str, tuple[s2r.Spec, str, Sequence[int]]] = {
        "specs/turtlebot.stl": (s2r.load_spec(ROOT / "specs/turtlebot.stl"), "turtlebot", SEEDS),
        "docs/tutorials/gap-and-cause.md": (tutorial(), "turtlebot", SEEDS),
        A1: (s2r.load_spec(ROOT / A1), "sim", options.a1),
    }
    table, runs = [], []
    for name, (spec, backend, seeds) in cases.items():
        planned, took = planned_of(spec)
        found = earlier(planned, options.output) if backend == "sim" else []
        for stop in ("epsilon", "decided") if backend != "sim" else ("epsilon",):
            found += [complete(name, spec, backend, seed, stop, planned) for seed in seeds]
        until = [run for run in found if run.stop == "epsilon"]
        line: dict[str, Any] = {
            "spec": name,
            "low": planned[0],
            "high": planned[1],
            "plan_seconds": round(took, 2),
            "inside": sum(bool(run.inside) for run in until),
            "seeds": len(until),
        }
        print(f"{line}", flush=True)
        table.append(line)
        runs += found
    record = {
        "machine": describe("numpy", "torch") | {"mujoco_step_us": round(step, 1)},
        "plans": table,
        "runs": [asdict(run) for run in runs],
    }
    options.output.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
