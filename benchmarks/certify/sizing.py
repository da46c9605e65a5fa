"""How many workers pay: rollouts per second, cost of a batch, memory and disk, on processes and on a Dask cluster.

    OMP_NUM_THREADS=1 python -m benchmarks.certify.sizing [--write]      # about two minutes on a quiet machine

The Dask cluster runs on this machine, so it shows what Dask adds, and no network. Beside every rate stands the time of
a MuJoCo step of the A1, measured just before: it tells machines apart, and a quiet machine from a busy one. With
``--write`` the result goes to results/sizing.json and into the tables of docs/how-to/sizing.md.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import product
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import numpy as np

import s2r_spec as s2r
from benchmarks import worker
from benchmarks.a1.gaps import step_of_the_a1
from benchmarks.machine import describe
from s2r_spec.certify.search.observers import Observer
from s2r_spec.runs.journal import FILE, Record
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.seeds import rollout_seed
from s2r_spec.runs.task import Task
from s2r_spec.workers.pools import ExecutorFactory, cores, dask_pool, process_pool

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "sizing.json"
PAGE = ROOT / "docs" / "how-to" / "sizing.md"

BACKENDS = {
    "sim": ("a1_velocity.stl", "walking", {"vd": 0.3}, 60),
    "turtlebot": ("turtlebot.stl", "delivers", {"ox": 0.0, "oy": 0.1}, 240),
}
"""Backend → its spec, requirement, test, and the rollouts that are timed."""
POOLS = ("processes", "dask")
WARM = 3
"""Rollouts of each worker before the timed ones."""
BUDGET = 40
"""Rollouts of the checks whose batches are timed."""
QUIET = 0.5
"""Level: load average above which no rates are measured, for other programs are busy."""
TOTALS = (100, 300, 600, 1300)
"""Rollouts of a whole search, for the table of the largest speed-up."""
WORKERS = (2, 4, 8, 16, 32, 64)
"""Workers in that table."""


class Clock(Observer):
    """Notes when batches begin and when rollouts are on disk.

    Attributes:
        sizes: rollouts of each batch.
        between: seconds of processor time from the last rollout of a batch to the beginning of the next.
    """

    def __init__(self) -> None:
        self.sizes: list[int] = []
        self.between: list[float] = []
        self._last = math.nan

    def batch(self, queries: list[Any], certificate: object) -> None:
        """Note a batch."""
        if self.sizes:
            self.between.append(thread_time() - self._last)
        self.sizes.append(sum(query.replicates for query in queries))

    def rollout(self, record: Record, new: bool = True) -> None:
        """Note a rollout."""
        self._last = thread_time()


@contextmanager
def pools(kind: str, workers: int) -> Iterator[tuple[ExecutorFactory, Any]]:
    """Give a factory of pools with so many workers, and a Dask client if there is a cluster."""
    if kind == "processes":
        yield process_pool(workers), None
        return
    distributed = import_module("distributed")
    settings = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": 50}
    with distributed.LocalCluster(**settings) as cluster, distributed.Client(cluster) as client:
        yield dask_pool(cluster.scheduler_address), client


def rate(factory: ExecutorFactory, workers: int, tasks: list[Task]) -> float:
    """Return rollouts per second; the first of each worker, which load libraries, are not timed."""
    warm = WARM * workers
    with Runner(factory) as runner:
        for _ in runner.run(tasks[:warm]):
            pass
        start = perf_counter()
        count = sum(1 for _ in runner.run(tasks[warm:]))
        return count / (perf_counter() - start)


def rates(counts: list[int]) -> list[dict[str, Any]]:
    """Return one row for each pool, number of workers and backend."""
    rows: list[dict[str, Any]] = []
    alone: dict[str, float] = {}  # of one local process, by backend: it comes first
    for kind, workers in product(POOLS, counts):
        with pools(kind, workers) as (factory, _):
            for name, (spec, requirement, test, rollouts) in BACKENDS.items():
                scorer = Scorer.for_spec(s2r.load_spec(ROOT / "specs" / spec), requirement, name)
                tasks = [
                    scorer.task(i, 0, test, rollout_seed(0, i, 0)) for i in range(rollouts + WARM * workers)
                ]
                step = step_of_the_a1()
                found = rate(factory, workers, tasks)
                efficiency = found / (workers * alone.setdefault(name, found))
                row = {"backend": name, "pool": kind, "workers": workers, "rate": found}
                rows.append(row | {"efficiency": efficiency, "step_us": step})
                print(
                    f"{name:10} {kind:10} {workers:2} workers: {found:7.2f} rollouts/s, "
                    f"efficiency {efficiency:.2f}; a MuJoCo step {step:.1f} µs",
                    flush=True,
                )
    return rows


def checks(workers: int) -> list[dict[str, Any]]:
    """Return what the batches of a check of the A1 cost, and what it leaves on disk, on each pool."""
    spec, rows = s2r.load_spec(ROOT / "specs" / "a1_velocity.stl"), []
    for kind in POOLS:
        clock, step = Clock(), step_of_the_a1()
        with tempfile.TemporaryDirectory() as place, pools(kind, workers) as (factory, client):
            folder = Path(place) / "run"
            s2r.check(spec, "sim", folder, budget=BUDGET, stop="epsilon", executor=factory, observer=clock)
            count = sum(clock.sizes)
            traces = sum(path.stat().st_size for path in (folder / "traces").iterdir())
            # The first batch loads libraries in the workers, and is left out.
            row = {
                "pool": kind,
                "workers": workers,
                "sizes": clock.sizes,
                "between_ms": 1e3 * float(np.median(clock.between[1:])),
                "journal_bytes": (folder / FILE).stat().st_size / count,
                "trace_bytes": traces / count,
                "step_us": step,
                "dask_worker_mib": max(client.run(worker.peak).values()) if client else None,
            }
        rows.append(row)
        print(
            f"check, {kind}, {workers} workers: {count} rollouts in batches of {clock.sizes}; "
            f"{row['between_ms']:.0f} ms between two; {row['journal_bytes']:.0f} bytes of journal and "
            f"{row['trace_bytes']:.0f} of trace a rollout; a MuJoCo step {step:.1f} µs",
            flush=True,
        )
    return rows


def batches(total: int) -> list[int]:
    """Return the sizes of the batches of a search of so many rollouts: 8 at first, later a tenth of those done."""
    sizes: list[int] = []
    while (done := sum(sizes)) < total:
        sizes.append(max(8, math.ceil(0.1 * done)))
    return sizes


def speed_up(sizes: list[int], workers: int) -> float:
    """Return the largest speed-up over one worker: every batch waits for its last rollout, nothing else costs."""
    return sum(sizes) / sum(math.ceil(size / workers) for size in sizes)


def _table(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def _rates_table(found: dict[str, Any]) -> str:
    if not found["rates"]:
        return "No rates yet: the machine was not quiet. The command measures them on yours."
    return _table(
        ("backend", "pool", "workers", "rollouts per second", "efficiency", "MuJoCo step"),
        [
            (
                f"`{row['backend']}`",
                row["pool"],
                row["workers"],
                f"{row['rate']:.1f}",
                f"{row['efficiency']:.2f}",
                f"{row['step_us']:.1f} µs",
            )
            for row in found["rates"]
        ],
    )


def _batches_table(found: dict[str, Any]) -> str:
    rows = []
    for total in TOTALS:
        sizes = batches(total)
        rows.append((total, len(sizes), sizes[-1], *(f"{speed_up(sizes, count):.1f}" for count in WORKERS)))
    return _table(("rollouts", "batches", "largest batch", *(f"{count} workers" for count in WORKERS)), rows)


def _costs_table(found: dict[str, Any]) -> str:
    local, dask = found["checks"]
    return _table(
        ("cost", "processes", "Dask"),
        [
            (
                "processor time between two batches",
                f"{local['between_ms']:.0f} ms",
                f"{dask['between_ms']:.0f} ms",
            ),
            ("MuJoCo step at that time", f"{local['step_us']:.1f} µs", f"{dask['step_us']:.1f} µs"),
            ("memory of a worker of `sim`", f"{found['worker_mib']:.0f} MiB", "the same"),
            ("memory of the Dask worker that starts it", "–", f"{dask['dask_worker_mib']:.0f} MiB"),
            ("journal, per rollout", f"{local['journal_bytes']:.0f} bytes", "the same"),
            ("trace, per rollout", f"{local['trace_bytes']:.0f} bytes", "the same"),
        ],
    )


def _machine(found: dict[str, Any]) -> str:
    machine = found["machine"]
    about = f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {machine['date']}"
    return f"Measured on {about}. The load average was {machine['load']:.1f} when it began."


TABLES = {"machine": _machine, "rates": _rates_table, "batches": _batches_table, "costs": _costs_table}
_BLOCK = re.compile(r"(<!-- table: (\w+) -->\n)(?:.*?\n)??(<!-- end -->)", re.S)


def with_tables(page: str, found: dict[str, Any]) -> str:
    """Return the page with its tables made from a result."""
    return _BLOCK.sub(lambda block: f"{block[1]}{TABLES[block[2]](found)}\n{block[3]}", page)


def main() -> None:
    """Measure all, print it, and write it if that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--write", action="store_true", help="write results/sizing.json and docs/how-to/sizing.md"
    )
    options = parser.parse_args()
    counts, load = [count for count in (1, *WORKERS) if count <= cores()], os.getloadavg()[0]
    if load > QUIET:
        print(f"the load average is {load:.1f}, so other programs are busy: no rates are measured")
    found = {
        "machine": describe("numpy", "mujoco", "distributed") | {"load": load},
        "rates": rates(counts) if load <= QUIET else [],
        "checks": checks(counts[-1]),
        "worker_mib": worker.fresh()["peak"],
    }
    print(f"memory of a worker: {found['worker_mib']:.0f} MiB\n\n{_batches_table(found)}")
    if options.write:
        RESULTS.write_text(json.dumps(found, indent=1) + "\n")
        PAGE.write_text(with_tables(PAGE.read_text(), found))


if __name__ == "__main__":
    main()
