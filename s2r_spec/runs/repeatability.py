"""Whether test and seed alone determine a simulator's trace, whatever ran before it and in whichever process.

A bound takes rollouts as independent given their tests. A simulator that keeps state between rollouts breaks this: its
traces depend on the order of the search, on the number of workers and on ``--resume``. So a backend that declares
``deterministic = True`` is tested once in each journal. One rollout of the first batch, with its test and its seed,
runs twice more:

    after a rollout of another test, in a process of the run     finds state that is kept between rollouts
    in a new process                                             finds what differs between processes

All traces must be equal, bit for bit. The two repeats have all channels, and the run's own trace has those of the
requirement. If any differ, the run is refused, and one more new process tells the likely cause: state, if both new
processes agree. State that changes no bit, such as a loaded model, passes.

The repeats are no data of a bound, and count in no budget. They lie beside the journal::

    repeats/repeats.json                                         the rollout, and why the run is refused, or null
    repeats/<query>.<replicate>.<same-process or new-process>.npz
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from s2r_spec import logs
from s2r_spec.backend import Backend, HasRecordings, is_exclusive
from s2r_spec.base import files
from s2r_spec.base.errors import UsageError
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.lines import JournalError
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.task import Done, Task, last_test, run_task
from s2r_spec.trace import Trace
from s2r_spec.workers.worker_process import WorkerProcess

FOLDER, FILE = "repeats", "repeats.json"
"""Definition: folder of the repeats in a journal's folder, and the file of their result in it."""
SCHEMA = "s2r.repeats/1"

_MEMORY = (
    "Likely cause: memory between rollouts in one process, for two new processes agree. "
    "Reset all state at the start of each rollout"
)
_PROCESS = (
    "Likely cause: the process matters, for two new processes differ. Look for random numbers without the seed, the "
    "hash seed, threads, the clock or a file. Draw all random numbers from the seed, or declare deterministic = False"
)
_EITHER = (
    "Likely cause: memory between rollouts, or random numbers without the seed. "
    "Reset all state at the start of each rollout, and draw all random numbers from the seed"
)


@dataclass(frozen=True)
class Difference:
    """The first difference of two rollouts: what differs, where, and both values in words."""

    what: str
    one: str
    other: str


def difference(one: Trace, other: Trace) -> Difference | None:
    """Return the first difference of two traces in time; None if they are the same, bit for bit.

    The other one has at least the channels of the first.
    """
    if first := _of_samples(one, other):
        return first
    ends = [trace.failure or "no failure" for trace in (one, other)]
    return None if ends[0] == ends[1] else Difference("the end", *ends)


def _of_rollouts(one: Done, other: Done) -> Difference | None:
    if one.trace is not None and other.trace is not None:
        return difference(one.trace, other.trace)
    ends = [done.failure or "a trace" for done in (one, other)]
    return None if ends[0] == ends[1] else Difference("the end", *ends)


def fault(first: Done, again: Done, afresh: Callable[[], Done] | None) -> str:
    """Return how repeats of a rollout differ and the likely cause, in sentences; "" if they do not differ.

    ``again`` ran after another test, in the same process or in a like one. ``afresh`` repeats the rollout in a new
    process; None if no other process can load the backend.
    """
    ran = [(first, " at first"), (again, " after another test in the same process")]
    if afresh is not None:
        ran.append((afresh(), " in a new process"))
    for (one, where), (other, elsewhere) in combinations(ran, 2):
        if unequal := _of_rollouts(one, other):
            cause = _EITHER
            if afresh is not None:
                cause = _MEMORY if _of_rollouts(ran[2][0], afresh()) is None else _PROCESS
            return f"{unequal.what} was {unequal.one}{where}, and {unequal.other}{elsewhere}. {cause}"
    return ""


def is_repeated(backend: Backend) -> bool:
    """Return whether the rollouts of a backend are repeated: a simulator that is declared as deterministic."""
    return backend.deterministic and not is_exclusive(backend) and not isinstance(backend, HasRecordings)


def unchecked_assumptions(backend: Backend, passed: PassedBackend | None) -> tuple[str, ...]:
    """Return what a certificate assumes because it was not checked, each in one sentence."""
    if is_exclusive(backend) or isinstance(backend, HasRecordings):
        return ()
    if not backend.deterministic:
        return (
            f"rollouts of {backend.name} do not depend on earlier ones; it is declared as not deterministic, so this "
            f"was not checked",
        )
    if passed is not None and not passed.portable:
        return (
            f"rollouts of {backend.name} do not depend on their process; no other process can load it, so they were "
            f"repeated in this one alone",
        )
    return ()


def check_run(journal: Journal, runner: Runner, rollouts: Sequence[tuple[Task, Record]]) -> None:
    """Repeat one rollout of a batch, unless the journal's folder has a result; see the module.

    Does nothing as long as no rollout of the run has a trace.

    Raises:
        UsageError: the repeats differ, now or before a resume.
    """
    if refuse_unrepeatable(journal.folder):
        return
    able = [(task, record) for task, record in rollouts if record.trace and _file(journal, record).is_file()]
    if not able:
        return
    # Neither the first rollout of its process nor the first of its test, if there is another: a simulator that keeps
    # the result of a test gives it for every seed.
    last = max(record.replicate for _, record in able)
    later = [(task, record) for task, record in able if record.replicate == last]
    task, record = later[len(later) // 2]
    others = sorted((one for one, _ in able if one != task), key=lambda one: one.params == task.params)
    whole = replace(task, channels=None)
    first = Done(task, logs.read(_file(journal, record)), record.seconds)
    (again,) = runner.run([whole], partial(run_after, others[0]) if others else run_task)
    portable = task.passed is None or task.passed.portable
    new: list[Done] = []

    def afresh() -> Done:
        new.extend(runner.run([whole], run_afresh))
        return new[-1]

    sentence = fault(first, again, afresh if portable else None)
    if sentence:
        test = ", ".join(f"{name} = {value:.6g}" for name, value in record.params.items())
        sentence = (
            f"{task.backend} is declared as deterministic, but rollout {record.query}.{record.replicate} "
            f"({test}, seed {record.seed}) gives other bits when it is repeated. {sentence}, and begin a new run"
        )
    _save(journal, record, {"same-process": again} | ({"new-process": new[0]} if new else {}), sentence)
    refuse_unrepeatable(journal.folder)


def refuse_unrepeatable(folder: Path) -> bool:
    """Return whether the folder of a journal has the result of repeats; a UsageError if the repeats differed."""
    path = folder / FOLDER / FILE
    if not path.exists():
        return False
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
        refused = result["refused"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise JournalError(f"{path} is damaged ({error}); delete it, and s2r repeats the rollout") from None
    if refused is not None:
        raise UsageError(f"no certificate: {refused}")
    return True


def check_here(
    backend: Backend, test: Mapping[str, float], other: Mapping[str, float], seed: int, elsewhere: bool = True
) -> str:
    """Run a test, another one, and the first again in this process and in a new one; return :func:`fault` of them.

    The tests are in the backend's units. The test is repeated in a new process only if ``elsewhere``.
    """
    passed = PassedBackend(backend)
    task = Task(0, 0, backend.name, test, seed, passed=passed)
    portable = passed.portable  # asked first: a copy must not have the state of these rollouts
    first = Done(task, *run_task(task))
    again = Done(task, *run_after(replace(task, params=other, seed=seed + 1), task))
    return fault(first, again, (lambda: Done(task, *run_afresh(task))) if portable and elsewhere else None)


def run_after(other: Task, task: Task) -> tuple[Trace, float]:
    """Run a task in this process after a rollout of another test: after the latest one, or after ``other``."""
    if last_test() in (None, task.params):
        run_task(replace(other, timeout=task.timeout))
    return run_task(task)


def run_afresh(task: Task) -> tuple[Trace, float]:
    """Run a task in a new process of this computer."""
    worker = WorkerProcess(uuid4().hex)
    try:
        trace, seconds = worker.call(run_task, task)
    finally:
        worker.close()
    return trace, seconds


def _file(journal: Journal, record: Record) -> Path:
    return journal.folder / str(record.trace)


def _save(journal: Journal, record: Record, repeats: Mapping[str, Done], refused: str) -> None:
    folder = journal.folder / FOLDER
    rows: list[dict[str, Any]] = []
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot write {folder}: {error.strerror or error}") from None
    for place, done in repeats.items():
        name = f"{record.query:05d}.{record.replicate:04d}.{place}.npz"
        if done.trace is not None:
            logs.write(done.trace, folder / name)
        trace, seconds = None if done.trace is None else name, round(done.seconds, 4)
        rows.append({"place": place, "trace": trace, "failure": done.failure, "seconds": seconds})
    result = {"schema": SCHEMA, "query": record.query, "replicate": record.replicate, "params": record.params}
    result |= {"seed": record.seed, "repeats": rows, "refused": refused or None}
    files.save(folder / FILE, json.dumps(result, indent=1) + "\n")


def _of_samples(one: Trace, other: Trace) -> Difference | None:
    """Return the first difference of two traces in time, then of their lengths."""
    if lost := [name for name in one.channels if name not in other.channels]:
        return Difference(f"the channel {lost[0]}", "there", "missing")
    size = min(len(one), len(other))
    rows: list[tuple[int, str, Any, Any, str]] = []
    columns = {"t": (one.times, other.times, "s")}
    columns |= {name: (one[name], other[name], one.units.get(name, "")) for name in one.channels}
    for name, (values, others, unit) in columns.items():
        if values.shape[1:] != others.shape[1:]:
            return Difference(f"the shape of {name}", str(values.shape[1:]), str(others.shape[1:]))
        flat, flat_others = (np.reshape(each[:size], (size, -1)) for each in (values, others))
        both_nan = (flat != flat) & (flat_others != flat_others)
        unequal = (flat != flat_others) & ~both_nan
        if unequal.any():
            row, column = (int(place) for place in np.argwhere(unequal)[0])
            label = name if flat.shape[1] == 1 else f"{name}[{column}]"
            rows.append((row, label, flat[row, column], flat_others[row, column], unit))
    if not rows:
        lengths = str(len(one)), str(len(other))
        return None if lengths[0] == lengths[1] else Difference("the number of samples", *lengths)
    row, label, value, changed, unit = min(rows, key=lambda each: each[0])
    digits, digits_other = _distinct_digits(value, changed)
    return Difference(f"{label} at t = {one.times[row]:.6g} s", f"{digits} {unit}".rstrip(), digits_other)


def _distinct_digits(one: Any, other: Any) -> tuple[str, str]:
    """Return two unequal numbers with as many digits as tell them apart, at least six."""
    for digits in range(6, 18):
        words = f"{one:.{digits}g}", f"{other:.{digits}g}"
        if words[0] != words[1]:
            break
    return words
