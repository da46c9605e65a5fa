"""What a worker of `s2r check` costs, measured in a fresh one: memory, and processor time of its rollouts."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import process_time

from s2r_spec.runs.task import open_backend
from s2r_spec.workers.worker_process import WorkerProcess


def rollouts(backend: str, duration: float, count: int) -> dict[str, float]:
    """Run rollouts in this process; return processor seconds of the first and the median one, and peak MiB."""
    seconds = []
    for seed in range(count):
        start = process_time()
        open_backend(backend, duration).rollout({"vd": 0.3}, seed)
        seconds.append(process_time() - start)
    return {"first": seconds[0], "median": sorted(seconds)[count // 2], "best": min(seconds), "peak": peak()}


def peak() -> float:
    """Return the most memory that this process had since it was started [MiB].

    ``getrusage`` would count what the process had that started it, too.
    """
    status = Path("/proc/self/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:")) / 1024


def fresh(backend: str = "sim", duration: float = 1.5, count: int = 5) -> dict[str, float]:
    """Return :func:`rollouts` of a worker that was just started, as `s2r check` starts one."""
    worker = WorkerProcess("measure")
    try:
        found: dict[str, float] = worker.call(rollouts, backend, duration, count)
        return found
    finally:
        worker.close()


@contextmanager
def nothing_compiled() -> Iterator[None]:
    """Give Numba an empty folder for what it keeps, as on a machine where s2r never ran."""
    before = os.environ.get("NUMBA_CACHE_DIR")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder
        try:
            yield
        finally:
            del os.environ["NUMBA_CACHE_DIR"]
            if before is not None:
                os.environ["NUMBA_CACHE_DIR"] = before
