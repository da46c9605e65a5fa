"""What the commands share: errors to sentences, and where a run lives."""

from __future__ import annotations

import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from s2r_spec.errors import S2RError, TraceNote, UsageError

if TYPE_CHECKING:
    from s2r_spec.rollouts.pools import ExecutorFactory

CODES = {"holds": 0, "violated": 1, "unknown": 3}
COLOURS = {"holds": "bold green", "violated": "bold red", "unknown": "bold yellow"}

_said = False


def worst(verdicts: Iterable[str]) -> str:
    """Return the verdict of several together, as the exit codes are ranked: 1 > 3 > 0."""
    found = set(verdicts)
    return next(verdict for verdict in ("violated", "unknown", "holds") if verdict in found)


@contextmanager
def sentences(as_json: bool = False) -> Iterator[None]:
    """Turn s2r's own errors into one sentence on stderr (and one object on stdout), and the exit code.

    What a reader of logs left out is a note on stderr.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", TraceNote)
            warnings.showwarning = _noted(warnings.showwarning)
            yield
    except S2RError as error:
        print(f"error: {error}" if not str(error).startswith("error") else str(error), file=sys.stderr)
        if as_json:
            print_error(error.exit_code, str(error))
        raise typer.Exit(error.exit_code) from error


def _noted(shown: Callable[..., None]) -> Callable[..., None]:
    """Return what shows a warning: a note of a reader as a note, others as ever."""

    def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        if issubclass(category, TraceNote):
            note(str(message))
        else:
            shown(message, category, *rest, **more)

    return show


def note(sentence: str) -> None:
    """Say on stderr what changes no answer, but should be known."""
    print(f"note: {sentence}", file=sys.stderr)


def print_error(exit_code: int, sentence: str) -> None:
    """Print an error as the one JSON object on stdout."""
    global _said
    _said = True
    print(json.dumps({"schema": "s2r.error/1", "exit_code": exit_code, "error": sentence}, allow_nan=False))


def answered() -> None:
    """Say that stdout has its JSON object, in which errors are, too."""
    global _said
    _said = True


def error_was_printed() -> bool:
    """Return whether this process printed its errors as JSON."""
    return _said


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pool(workers: int | None, scheduler: str | None) -> tuple[ExecutorFactory, str]:
    """Return the factory of the pool that runs the rollouts, and what to call it.

    Raises:
        UsageError: both are given, or Dask is not installed.
    """
    from s2r_spec.rollouts.pools import dask_pool, process_pool

    if scheduler is None:
        count = workers or cores()
        return process_pool(count), f"{count} worker{'s' if count > 1 else ''}"
    if workers is not None:
        raise UsageError(
            "--workers is for this machine, --scheduler has workers of its own: give one of them"
        )
    return dask_pool(scheduler), f"scheduler {scheduler}"


def seconds(timeout: float | None) -> float | None:
    """Return the time-out of a rollout as the library takes it."""
    return math.inf if timeout == 0 else timeout


def new_or_old(run: Path | None, resume: Path | None, name: str, seed: int) -> Path:
    """Return the folder of a run: the one given, or a new one under ``s2r-runs``.

    Raises:
        UsageError: both were given, or there is nothing to resume.
    """
    if run is not None and resume is not None:
        raise UsageError("--run begins a new run, --resume goes on with an old one: give one of them")
    if resume is not None and not resume.is_dir():
        raise UsageError(f"no run to resume at {resume}: there is no such folder")
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    return (
        resume or run or Path("s2r-runs") / f"{stamp}-{name.replace(':', '-').replace('/', '-')}-seed{seed}"
    )


def begun(
    run: Path | None,
    resume: Path | None,
    name: str,
    seed: int,
    workers: int | None,
    scheduler: str | None,
    quiet: bool,
) -> tuple[ExecutorFactory, Path, Console]:
    """Return pool, folder and standard error of a run, after saying there where it is.

    Raises:
        UsageError: as :func:`pool` and :func:`new_or_old` say.
    """
    executor, machines = pool(workers, scheduler)
    folder = new_or_old(run, resume, name, seed)
    errors = Console(stderr=True, highlight=False)
    if not quiet:
        errors.print(f"run {folder}, seed {seed}, {machines}", markup=False, soft_wrap=True)
    return executor, folder, errors


def interrupted(folder: Path) -> None:
    """Say how an interrupted run goes on."""
    print(f"interrupted; go on with --resume {folder}", file=sys.stderr)
