"""Parts that the commands share: error messages, pools, and folders of runs."""

from __future__ import annotations

import errno
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from s2r_spec.base.errors import ErrorCode, S2RError, StoppedError, TraceNote, UsageError
from s2r_spec.base.json_values import line
from s2r_spec.base.printable import one_line
from s2r_spec.cli.terminal.terminal import say

if TYPE_CHECKING:
    from s2r_spec.backend import Finding
    from s2r_spec.cli.options.search import Running
    from s2r_spec.workers.pools import ExecutorFactory

answered = Event()
"""Whether stdout has its JSON object, with the errors in it."""
_new: list[Path] = []
"""Folders that this command has made; empty ones are removed at its end."""


@contextmanager
def sentences(as_json: bool = False) -> Iterator[None]:
    """Print s2r's own errors as one sentence on stderr, or as JSON on stdout, too, and exit with their code.

    Warnings about samples that a log reader left out become notes on stderr.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", TraceNote)
            warnings.showwarning = _print_notes(warnings.showwarning)
            yield
    except S2RError as error:
        _refuse(str(error), error.exit_code, as_json, error)
    except OSError as error:
        if error.filename is None or error.errno == errno.EPIPE:
            raise
        # For example a name that is too long, or a folder without permission.
        _refuse(one_line(f"{error.filename}: {error.strerror}"), UsageError.exit_code, as_json, error)
    finally:
        for folder in _new:
            with suppress(OSError):  # rmdir removes an empty folder only: nothing was recorded in it
                folder.rmdir()
                folder.parent.rmdir()
        _new.clear()


def _refuse(sentence: str, exit_code: ErrorCode, as_json: bool, cause: Exception) -> NoReturn:
    if isinstance(cause, StoppedError):  # the operator asked for it: no error
        say(sentence, error=True)
    else:
        print(sentence if sentence.startswith("error") else f"error: {sentence}", file=sys.stderr)
    if as_json:
        print_error(exit_code, sentence)
    raise typer.Exit(exit_code) from cause


def _print_notes(shown: Callable[..., None]) -> Callable[..., None]:
    """Return a function that prints a TraceNote as a note, and other warnings as before."""

    def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        if issubclass(category, TraceNote):
            note(str(message))
        else:
            shown(message, category, *rest, **more)

    return show


def note(sentence: str) -> None:
    """Print a note on stderr: a fact that changes no result but matters to the reader."""
    say(f"note: {sentence}", error=True)


def print_error(exit_code: ErrorCode, sentence: str) -> None:
    """Print an error as the one JSON object on stdout."""
    from s2r_spec.report.records.error import ErrorObject

    answered.set()
    print(line(ErrorObject(exit_code=exit_code, error=sentence)))


def pool(workers: int | None, scheduler: str | None) -> tuple[ExecutorFactory, str]:
    """Return the factory of the pool that runs the rollouts, and the pool's name for messages.

    Raises:
        UsageError: both are given, or Dask is not installed.
    """
    from s2r_spec.workers.pools import cores, dask_pool, process_pool

    if scheduler is None:
        count = workers or cores()
        return process_pool(count), f"{count} worker{'s' if count > 1 else ''}"
    if workers is not None:
        raise UsageError(
            "--workers counts processes on this computer, and a --scheduler has its own workers: give only one of them"
        )
    return dask_pool(scheduler), f"scheduler {scheduler}"


def refuse_without_operator(name: str) -> None:
    """Refuse a machine without an operator at the terminal, before numerical libraries are loaded.

    Other errors of a backend are reported where it is used. The search checks the operator again.

    Raises:
        UsageError: the machine needs an operator and stdin is not a terminal.
    """
    from s2r_spec.backend import HasAttendance, is_exclusive, load_backend
    from s2r_spec.machine.operator import Terminal, require_terminal

    operator = Terminal()
    if operator.there or name.startswith("log:"):
        return
    try:
        backend = load_backend(name)
    except S2RError:
        return
    if not is_exclusive(backend):
        return
    attendance = None
    if isinstance(backend, HasAttendance):
        with suppress(S2RError):  # a backend that needs the specification first has an operator
            attendance = backend.attendance(operator)
    if not getattr(attendance, "unattended", False):
        require_terminal(operator)


def new_or_old(run: Path | None, resume: Path | None, name: str, seed: int) -> Path:
    """Return the folder of a run: the one given, or a new one under ``s2r-runs`` that no other process has.

    Raises:
        UsageError: both were given, there is nothing to resume, or the folder cannot be made.
    """
    if run is not None and resume is not None:
        raise UsageError("--run begins a new run, and --resume continues one: give only one of them")
    if resume is not None and not resume.is_dir():
        raise UsageError(f"no run to resume at {resume}: the folder does not exist")
    if run is not None and run.exists() and not run.is_dir():
        raise UsageError(f"cannot begin a run in {run}: it is not a folder")
    if (given := resume or run) is not None:
        return given
    from s2r_spec.runs.layout import new_run

    folder = new_run(name, seed)
    _new.append(folder)
    return folder


def begin_run(running: Running, name: str, seed: int, real: str) -> tuple[ExecutorFactory, Path, str]:
    """Return the pool and the folder of a run with a machine, and the line to print when it begins.

    Raises:
        UsageError: see :func:`pool` and :func:`new_or_old`.
        BackendError: the machine does not exist.
    """
    executor, machines = pool(running.workers, running.scheduler)
    turns = f", one rollout of {real} at a time" if takes_turns(real) else ""
    folder = new_or_old(running.run, running.resume, name, seed)
    return executor, folder, f"run {folder}, seed {seed}, {machines}{turns}"


def takes_turns(name: str) -> bool:
    """Return whether the rollouts of a backend run one at a time, for any number of workers; opens nothing.

    Raises:
        BackendError: the backend does not exist.
    """
    from s2r_spec.backend import is_exclusive, load_backend

    # A folder of logs is not a machine, and is slow to load.
    return not name.startswith("log:") and is_exclusive(load_backend(name))


def finding_lines(finding: Finding) -> Iterator[str]:
    """Yield the lines of a finding of a pre-flight."""
    mark = {"ok": "ok", "note": "note", "wrong": "WRONG"}[finding.level]
    yield f"{mark:6}  {finding.topic}: {finding.words}"
    yield from (f"        {row}" for row in finding.table)


def print_preflight(name: str, quiet: bool) -> None:
    """Print the few lines of a backend's pre-flight that need no rollout; most backends have none."""
    from s2r_spec.backend import HasPreflight, load_backend

    if quiet or name.startswith("log:") or not isinstance(backend := load_backend(name), HasPreflight):
        return
    from s2r_spec.testing.preflight import in_short

    for finding in in_short(backend):
        first, *_ = finding_lines(finding)
        say(first, error=True)
    say(f"all of the pre-flight: s2r backends {name} --check", error=True)


@contextmanager
def resumable(folder: Path) -> Iterator[None]:
    """Print how to continue an interrupted run, given its folder."""
    try:
        yield
    except KeyboardInterrupt:
        recorded = any(path.is_file() for path in folder.rglob("*"))
        words = f"continue with --resume {folder}" if recorded else "nothing was recorded"
        say(f"interrupted; {words}", error=True)
        raise
