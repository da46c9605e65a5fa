"""One rollout in a worker: the task, its result, and the function that runs it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from socket import gethostname
from time import perf_counter

from s2r_spec.backend import (
    Backend,
    HasDuration,
    KeepsRaw,
    NeedsSpec,
    Prepares,
    SaysWhenItBegins,
    is_exclusive,
    load_backend,
    refuse_unknown,
    short,
)
from s2r_spec.backend.protocols import run_protocol
from s2r_spec.base.errors import BackendError, NotBegunError, S2RError, one_of, suggest
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.trace import Trace
from s2r_spec.workers.limits import Limit
from s2r_spec.workers.worker import end_copy, limit

OPENING = 60.0
"""Budget: time to load a backend on top of a rollout [s], for a cold disk or a licence server."""


@dataclass(frozen=True)
class Task:
    """One rollout to run: its key in the journal, and all settings that a worker needs."""

    query: int
    replicate: int
    backend: str
    params: Mapping[str, float]
    seed: int
    duration: float | None = None
    channels: tuple[str, ...] | None = None
    """Channels of the returned trace; None for all."""
    model_hash: str | None = None
    """Model hash that the worker's backend must have; None for any."""
    timeout: float = math.inf
    """Time limit of the rollout [s]: of CPU time for a simulator, and ten times as much on the wall clock; of wall
    time for a machine."""
    attended: bool = False
    """Whether the operator has confirmed the rollout; a machine runs no other."""
    raw: str | None = None
    """Folder for recordings other than the trace; None to keep none."""
    passed: PassedBackend | None = None
    """The backend, if the caller passed it as an object; None to open it by its name."""
    protocol: str | None = None
    """Name of a protocol to run with ``params``; None for a test of the specification."""


@dataclass(frozen=True)
class Done:
    """Result of a task: a trace, or the reason why there is none, such as "crash: the worker died 3 times".

    A ``failure`` counts even if there is a trace.
    """

    task: Task
    trace: Trace | None
    seconds: float
    failure: str | None = None


@cache
def open_backend(name: str, duration: float | None) -> Backend:
    """Load a backend once per process, with rollouts of ``duration`` seconds if that is given.

    A BackendError says that its rollouts have a fixed length that is too short.
    """
    return with_rollout_duration(load_backend(name), name, duration)


def with_rollout_duration(backend: Backend, name: str, duration: float | None) -> Backend:
    """Return a backend with rollouts of ``duration`` seconds if that is given; see :func:`open_backend`."""
    if duration is None or duration == backend.duration:
        return backend
    if isinstance(backend, HasDuration):
        return backend.with_duration(duration)
    if duration > backend.duration:
        raise BackendError(
            f"the spec looks {duration:g} s ahead, but rollouts of backend {name!r} last {backend.duration:g} s; "
            f"shorten the windows of the spec"
        )
    return backend


def run_task(task: Task) -> tuple[Trace, float]:
    """Run one rollout in this process; return its trace and the seconds it took.

    Raises:
        UsageError: the backend does not declare one of the test's parameters.
        BackendError: the rollout raised any exception, even SystemExit; or it returned no trace, or a trace that
            lacks a channel. The original exception may not pickle, and must not end s2r.
    """
    limit(_opening_limit(task))
    with _name_errors(task, NotBegunError):
        backend = _open(task)
        # A machine is prepared before the operator is asked. A first rollout may compile for longer than it may take.
        prepared = is_exclusive(backend) or any(backend is one for one in _prepared)
        if isinstance(backend, Prepares) and not prepared:
            backend.prepare()
            _prepared.append(backend)
        declared = tuple(backend.parameters)
    # A protocol checks its own parameters. A backend that takes them from the spec has none if opened by its name.
    if task.protocol is None and (declared or not isinstance(backend, NeedsSpec)):
        refuse_unknown(task.backend, declared, task.params)
    global _last_test
    with _name_errors(task):
        of_rollout = Limit(task.timeout) if is_exclusive(backend) else Limit.of_simulation(task.timeout)
        if isinstance(backend, SaysWhenItBegins):
            backend = backend.saying(partial(limit, of_rollout))
            limit(_opening_limit(task))
        else:
            limit(of_rollout)
        start = perf_counter()
        _last_test = task.params
        if task.protocol is None:
            trace = backend.rollout(task.params, task.seed)
        else:
            trace = run_protocol(backend, task.protocol, task.params, task.seed)
        seconds = perf_counter() - start
    if not isinstance(trace, Trace):
        raise BackendError(
            f"backend {task.backend!r} returned a {type(trace).__name__} instead of a Trace {_where(task)}"
        )
    try:
        json.dumps(dict(trace.meta))
    except (TypeError, ValueError, RecursionError) as error:  # the last two: meta contains itself
        raise BackendError(
            f"backend {task.backend!r}: the trace's meta cannot be written as JSON: {error} {_where(task)}"
        ) from None
    for name in task.channels or ():
        if name not in trace.channels:
            raise BackendError(
                f"backend {task.backend!r} recorded no channel {name!r} {_where(task)}"
                f"{suggest(name, trace.channels)} it recorded {one_of(trace.channels)}"
            )
    return (trace if task.channels is None else trace.only(task.channels)), seconds


_prepared: list[Backend] = []
_last_test: Mapping[str, float] | None = None


def last_test() -> Mapping[str, float] | None:
    """Return the test of the latest rollout of :func:`run_task` in this process; None before the first."""
    return _last_test


def prepare(task: Task) -> None:
    """Open a task's backend in this process, and prepare it; raise a NotBegunError if that fails."""
    limit(_opening_limit(task))
    with _name_errors(task, NotBegunError):
        backend = _open(task)
        if isinstance(backend, Prepares):
            backend.prepare()


def _opening_limit(task: Task) -> Limit:
    return Limit(task.timeout + OPENING, opening=True)


def _where(task: Task) -> str:
    return f"at {dict(task.params)}, seed {task.seed}"


@contextmanager
def _name_errors(task: Task, kind: type[BackendError] = BackendError) -> Iterator[None]:
    try:
        yield
    except NotBegunError as error:  # the caller names the rollout
        raise NotBegunError(str(error)) from None
    except S2RError as error:
        raise kind(f"backend {task.backend!r}: {error} {_where(task)}") from None
    except BaseException as error:
        end_copy(error)
        words = f"{type(error).__name__}: {error} {_where(task)}"
        raise kind(f"backend {task.backend!r} raised {words}") from None


def _open(task: Task) -> Backend:
    """Return a task's backend; check that its model is the one that the run began with."""
    passed = task.passed
    backend = open_backend(task.backend, task.duration) if passed is None else passed.backend
    if is_exclusive(backend) and not task.attended:
        raise BackendError(
            f"backend {task.backend!r} is a machine, and only s2r check, gap and certify ask its operator; use one of "
            f"these,"
        )
    if task.raw is not None:
        backend = _keep_recordings(backend, task.raw)
    if task.model_hash is not None and backend.model_hash != task.model_hash:
        raise BackendError(
            f"the worker on {gethostname()} has the model {short(backend.model_hash)}, but the run began with "
            f"{short(task.model_hash)}; install the same versions on both computers;"
        )
    return backend


_with_raw: list[tuple[Backend, str, Backend]] = []


def _keep_recordings(backend: Backend, folder: str) -> Backend:
    """Return the backend with its raw recordings in a folder; the same object for all tasks of a run."""
    if not isinstance(backend, KeepsRaw):
        return backend
    if not any(backend is original and folder == raw for original, raw, _ in _with_raw):
        _with_raw[:] = [(backend, folder, backend.keeping(folder))]
    return _with_raw[0][2]
