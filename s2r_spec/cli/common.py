"""What the commands share: errors to sentences, and where a run lives."""

from __future__ import annotations

import errno
import itertools
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import typer

from s2r_spec.cli.terminal import say
from s2r_spec.errors import ErrorCode, S2RError, StoppedError, TraceNote, UsageError
from s2r_spec.json_objects.error import ErrorObject
from s2r_spec.plain import line
from s2r_spec.printable import one_line

if TYPE_CHECKING:
    from s2r_spec.rollouts.pools import ExecutorFactory

CODES: dict[str, Literal[0, 1, 3]] = {"holds": 0, "violated": 1, "unknown": 3}
COLOURS = {"holds": "bold green", "violated": "bold red", "unknown": "bold yellow"}

_LONGEST_NAME = 150
"""Letters of a run's folder that say what it is of: a budget, of the 255 bytes that a file's name may have."""

_said = False
_new: list[Path] = []
"""Folders that this command has made; those that stay empty are taken away at its end."""


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
        _refuse(str(error), error.exit_code, as_json, error)
    except OSError as error:
        if error.filename is None or error.errno == errno.EPIPE:
            raise
        # A name that is too long, a folder that may not be read: what a caller of the system was refused.
        _refuse(one_line(f"{error.filename}: {error.strerror}"), UsageError.exit_code, as_json, error)
    finally:
        for folder in _new:
            with suppress(OSError):  # only an empty one goes: nothing was recorded in it
                folder.rmdir()
                folder.parent.rmdir()
        _new.clear()


def _refuse(sentence: str, exit_code: ErrorCode, as_json: bool, cause: Exception) -> NoReturn:
    # A specification's mistakes are drawn below its sentence.
    first, line_feed, rest = sentence.partition("\n")
    if isinstance(cause, StoppedError):  # as was asked: no error
        say(sentence, error=True)
    else:
        print(
            f"error: {first}{line_feed}{rest}" if not first.startswith("error") else sentence, file=sys.stderr
        )
    if as_json:
        print_error(exit_code, sentence)
    raise typer.Exit(exit_code) from cause


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
    say(f"note: {sentence}", error=True)


def print_error(exit_code: ErrorCode, sentence: str) -> None:
    """Print an error as the one JSON object on stdout."""
    global _said
    _said = True
    print(line(ErrorObject(exit_code=exit_code, error=sentence)))


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


def refuse_without_operator(name: str) -> None:
    """Refuse a machine whose operator is at no terminal, before numerical libraries are loaded for seconds.

    What else is wrong with a backend is said where it is used; the search asks again.

    Raises:
        UsageError: see there.
    """
    from s2r_spec.backend import HasAttendance, is_exclusive, load_backend
    from s2r_spec.rollouts.operator import Terminal, refuse_nobody

    operator = Terminal()
    if operator.there or name.startswith("log:"):
        return
    try:
        backend = load_backend(name)
    except S2RError:
        return
    if not is_exclusive(backend):
        return
    attended = None
    if isinstance(backend, HasAttendance):
        with suppress(S2RError):  # one that needs the specification first is attended
            attended = backend.attendance(operator)
    if not getattr(attended, "unattended", False):
        refuse_nobody(operator)


def seconds(timeout: float | None) -> float | None:
    """Return the time-out of a rollout as the library takes it."""
    return math.inf if timeout == 0 else timeout


def new_or_old(run: Path | None, resume: Path | None, name: str, seed: int) -> Path:
    """Return the folder of a run: the one given, or a new one under ``s2r-runs`` that no other process has.

    Raises:
        UsageError: both were given, there is nothing to resume, or the folder cannot be made.
    """
    if run is not None and resume is not None:
        raise UsageError("--run begins a new run, --resume goes on with an old one: give one of them")
    if resume is not None and not resume.is_dir():
        raise UsageError(f"no run to resume at {resume}: there is no such folder")
    if run is not None and run.exists() and not run.is_dir():
        raise UsageError(f"cannot begin a run in {run}: it is not a folder")
    return resume or run or _new_folder(Path("s2r-runs"), name, seed)


def _new_folder(root: Path, name: str, seed: int) -> Path:
    """Make a folder that was not there: its name has the second, and a number where another process was faster."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    # Backends are called log:FOLDER; a name of a file has 255 bytes at most.
    plain = re.sub(r"[^\w.,+=-]", "-", name, flags=re.ASCII)[:_LONGEST_NAME]
    try:
        root.mkdir(parents=True, exist_ok=True)
        for number in itertools.count(1):
            folder = root / f"{stamp}-{plain}-seed{seed}{f'-{number}' if number > 1 else ''}"
            with suppress(FileExistsError):
                folder.mkdir()
                _new.append(folder)
                return folder
    except OSError as error:
        raise UsageError(f"cannot make a folder for the run in {root}: {error.strerror or error}") from None
    raise AssertionError  # itertools.count has no end


def begun(
    run: Path | None,
    resume: Path | None,
    name: str,
    seed: int,
    workers: int | None,
    scheduler: str | None,
    real: str,
) -> tuple[ExecutorFactory, Path, str]:
    """Return pool and folder of a run against a machine, and what to say of it once its backends are accepted.

    Raises:
        UsageError: as :func:`pool` and :func:`new_or_old` say.
        BackendError: there is no such machine.
    """
    executor, machines = pool(workers, scheduler)
    turns = f", one rollout of {real} at a time" if takes_turns(real) else ""
    folder = new_or_old(run, resume, name, seed)
    return executor, folder, f"run {folder}, seed {seed}, {machines}{turns}"


def takes_turns(name: str) -> bool:
    """Return whether the rollouts of a backend run one at a time, whatever the workers; opens nothing.

    Raises:
        BackendError: there is no such backend.
    """
    from s2r_spec.backend import is_exclusive, load_backend

    # A folder of logs is no machine, and takes long to load.
    return not name.startswith("log:") and is_exclusive(load_backend(name))


def interrupted(folder: Path) -> None:
    """Say how an interrupted run goes on."""
    if any(path.is_file() for path in folder.rglob("*")):
        say(f"interrupted; go on with --resume {folder}", error=True)
    else:
        say("interrupted; nothing was recorded yet", error=True)
