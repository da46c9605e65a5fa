"""What does one core buy in an hour, and what of it does s2r itself take?

Rollouts per second of the A1 with one and with two workers, what the framework adds to each rollout, the
memory of a worker, and the time of `s2r --help`. Wall-clock numbers mean what they say on a quiet machine
only: the load average before and after stands beside them, and processor time is given where it can be. ::

    OMP_NUM_THREADS=1 python -m benchmarks.paper.budget          # about 2 minutes
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import s2r_spec as s2r
from benchmarks import worker
from benchmarks.machine import describe
from s2r_spec.certify.search.search import Search
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.seeds import rollout_seed
from s2r_spec.runs.task import Task
from s2r_spec.workers.pools import process_pool

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parent / "results" / "budget.json"
CERTIFICATE = ROOT / "benchmarks" / "results" / "dense_reference.json"
SMALL = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
certify walking: delta = 1e-6, epsilon = 0.02, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""


def throughput(workers: int, count: int) -> float:
    """Return A1 rollouts per second; the workers have run one each before."""

    def tasks(first: int, some: int) -> list[Task]:
        return [
            Task(q, 0, "sim", {"vd": 0.3}, rollout_seed(9, q, 0), 1.5, ("vx",))
            for q in range(first, first + some)
        ]

    with Runner(process_pool(workers)) as runner:
        list(runner.run(tasks(0, 2 * workers)))
        start = perf_counter()
        list(runner.run(tasks(100, count)))
        return count / (perf_counter() - start)


class Timed:
    """Counts the processor time of a search's own work."""

    def __init__(self) -> None:
        self.spent = 0.0

    def around(self, name: str) -> None:
        method = getattr(Search, name)

        def timed(search: Search, *args: Any, **named: Any) -> Any:
            start = process_time()
            try:
                return method(search, *args, **named)
            finally:
                self.spent += process_time() - start

        setattr(Search, name, timed)


def overhead(folder: Path) -> dict[str, float]:
    """Return what a whole check adds to each rollout of a backend that takes next to no time [ms]."""
    sys.path.insert(0, str(ROOT / "tests" / "plugin"))
    spec = s2r.parse_spec(SMALL)
    timed = Timed()
    timed.around("ask")
    timed.around("tell")

    def used() -> float:
        times = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(each.ru_utime + each.ru_stime for each in times)

    s2r.check(spec, "toy", folder / "first", budget=40, executor=process_pool(1))  # imports
    timed.spent = 0.0
    # A worker's own start is no part of a rollout: it is what a check of 40 costs more than its rollouts.
    before, start = used(), perf_counter()
    short = s2r.check(spec, "toy", folder / "short", budget=40, executor=process_pool(1))
    between, middle = used(), perf_counter()
    short_search, timed.spent = timed.spent, 0.0
    long = s2r.check(spec, "toy", folder / "long", stop="epsilon", executor=process_pool(1))
    after, end = used(), perf_counter()
    more = long.certificate.rollouts - short.certificate.rollouts
    search = timed.spent - short_search
    backend = toy_cost()
    return {
        "rollouts": more,
        "wall_ms": 1e3 * ((end - middle) - (middle - start)) / more,
        "processor_ms": 1e3 * ((after - between) - (between - before)) / more,
        "of_which_search_ms": 1e3 * search / more,
        "of_which_backend_ms": 1e3 * backend,
    }


def toy_cost() -> float:
    """Return the processor seconds of one rollout of the toy backend."""
    backend = s2r.load_backend("toy")
    start = process_time()
    for seed in range(500):
        backend.rollout({"vd": 0.1}, seed)
    return (process_time() - start) / 500


def help_time(repeats: int) -> dict[str, float]:
    """Return the best and the median wall seconds of `s2r --help`."""
    command = [sys.executable, "-m", "s2r_spec", "--help"]
    seconds, used = [], []
    for _ in range(repeats):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        start = perf_counter()
        subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
        seconds.append(perf_counter() - start)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return {"best": min(seconds), "median": sorted(seconds)[repeats // 2], "processor": min(used)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rollouts", type=int, default=40, help="rollouts for each number of workers")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    load = os.getloadavg()[0]
    # In turns, the best of each: others use the machine, too, and never make it faster.
    turns = [{str(count): throughput(count, options.rollouts) for count in (1, 2)} for _ in range(3)]
    rates = {count: max(turn[count] for turn in turns) for count in ("1", "2")}
    with tempfile.TemporaryDirectory() as folder:
        added = overhead(Path(folder))
    helped = help_time(9)
    loaded = os.getloadavg()[0]
    usual = worker.fresh()
    with worker.nothing_compiled():
        compiling = worker.fresh()
    certificate = json.loads(CERTIFICATE.read_text())["certificate"]
    per_hour = 3600 / usual["median"]
    record = {
        "machine": describe("mujoco", "pin", "piqp", "numba"),
        "load_average": {"before": load, "after": loaded},
        "rollout_seconds": {key: usual[key] for key in ("best", "median", "first")},
        "rollouts_per_core_hour": round(per_hour),
        "certificates_per_core_hour": round(per_hour / certificate["rollouts"], 1),
        "rollouts_per_second": rates,
        "scaling": rates["2"] / rates["1"],
        "framework": added,
        "worker_MiB": {"usual": usual["peak"], "compiling": compiling["peak"]},
        "compiling_seconds": compiling["first"],
        "help_seconds": helped,
    }
    options.output.write_text(json.dumps(record, indent=1) + "\n")
    print(f"load average {load:.2f} before, {loaded:.2f} after")
    print(
        f"one rollout of the A1: {usual['median']:.3f} s of a core ({usual['best']:.3f} at best); a worker's first "
        f"{usual['first']:.1f} s, {compiling['first']:.0f} s where nothing is compiled yet"
    )
    print(
        f"one core-hour: {per_hour:.0f} rollouts, or {per_hour / certificate['rollouts']:.0f} certificates like the "
        f"README's ({certificate['rollouts']} rollouts)"
    )
    print(
        f"rollouts per second: {rates['1']:.1f} with one worker, {rates['2']:.1f} with two ({record['scaling']:.2f} ×)"
    )
    print(
        f"the framework, per rollout: {added['processor_ms']:.2f} ms of processor, {added['wall_ms']:.2f} ms of wall "
        f"time (wanted: <= 2), of which the search {added['of_which_search_ms']:.2f} ms and the toy backend "
        f"{added['of_which_backend_ms']:.2f} ms; over {added['rollouts']:.0f} rollouts"
    )
    print(
        f"peak memory of a worker: {usual['peak']:.0f} MiB, {compiling['peak']:.0f} MiB if it compiles (wanted: <= 300)"
    )
    print(f"s2r --help: {helped['median']:.2f} s, best {helped['best']:.2f} s (wanted: <= 0.3)")


if __name__ == "__main__":
    main()
