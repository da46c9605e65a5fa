"""The control loop of a robot's files, held against recordings of the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from s2r_spec import logs
from s2r_spec.backend import Backend, Finding, HasLoop, HasRecordings, load_backend
from s2r_spec.base.errors import UsageError
from s2r_spec.trace import Trace


def loop_findings(backend: Backend, log: str) -> tuple[list[Finding], int]:
    """Return what recordings say of each equation of the loop, each sentence once, and the number of recordings.

    A sentence that not all recordings say names their number. ``log`` is a file, a folder of files, or ``log:FOLDER``
    with its options.

    Raises:
        UsageError: the backend has no files that state a loop, or there are no recordings.
        TraceError: a file is no recording.
    """
    if not isinstance(backend, HasLoop):
        raise UsageError(f"no file states the control loop of {backend.name}; --log is for robot files")
    traces = _traces(log)
    counted: dict[tuple[str, str], tuple[Finding, int]] = {}
    for trace in traces:
        for one in backend.loop(trace):
            first, number = counted.get((one.topic, one.words), (one, 0))
            counted[one.topic, one.words] = first, number + 1
    every = len(traces)
    return [
        one if number == every else replace(one, words=f"{one.words} (in {number} of {every} recordings)")
        for one, number in counted.values()
    ], every


def _traces(log: str) -> list[Trace]:
    path, found = Path(log), list[Trace]()
    if path.is_file():
        found = [logs.read(path)]
    elif path.is_dir() and not (path / "rollouts.csv").exists():
        files = [one for one in sorted(path.iterdir()) if one.suffix in logs.READABLE]
        found = [logs.read(one) for one in files]
    else:
        real = load_backend(log if log.startswith("log:") else f"log:{log}")
        found = [one.trace for one in real.recordings] if isinstance(real, HasRecordings) else []
    if not found:
        raise UsageError(f"{log} has no recordings")
    return found
