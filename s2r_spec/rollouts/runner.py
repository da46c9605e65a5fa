"""Run rollouts on any `concurrent.futures.Executor`, and survive its workers.

A pool whose worker died fails every rollout in flight with it. So the runner
takes a factory, makes a new pool, and runs the suspects one at a time: one that
breaks its pool three times is recorded as a crash, the others are unharmed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context, parent_process
from threading import Thread
from time import perf_counter
from types import TracebackType
from typing import Self

from s2r_spec.backend import Backend, HasDuration, load_backend
from s2r_spec.errors import BackendError, S2RError
from s2r_spec.trace import Trace

STRIKES = 3

ExecutorFactory = Callable[[], Executor]


@dataclass(frozen=True)
class Task:
    """One rollout to run: its key in the journal, and all a worker needs to know."""

    query: int
    replicate: int
    backend: str
    params: Mapping[str, float]
    seed: int
    duration: float | None = None
    channels: tuple[str, ...] | None = None
    """Channels to bring back; None for all of them."""


@dataclass(frozen=True)
class Done:
    """What came of a task: a trace, or a crash of the worker that ran it."""

    task: Task
    trace: Trace | None
    seconds: float
    crash: str | None = None


@cache
def open_backend(name: str, duration: float | None) -> Backend:
    """Load a backend once per process, with rollouts of ``duration`` seconds if that is given.

    Raises:
        BackendError: the backend's rollouts have a fixed length that is too short.
    """
    backend = load_backend(name)
    if duration is None or duration == backend.duration:
        return backend
    if isinstance(backend, HasDuration):
        return backend.with_duration(duration)
    if duration > backend.duration:
        raise BackendError(
            f"the spec looks {duration:g} s ahead, but rollouts of backend {name!r} last {backend.duration:g} s"
        )
    return backend


def run_task(task: Task) -> tuple[Trace, float]:
    """Run one rollout in this process; return its trace and the seconds it took.

    Raises:
        BackendError: whatever the rollout raised, SystemExit included, in one sentence: the
            original may not survive the way between processes, and must not end s2r.
    """
    start = perf_counter()
    where = f"at {dict(task.params)}, seed {task.seed}"
    try:
        trace = open_backend(task.backend, task.duration).rollout(task.params, task.seed)
    except S2RError as error:
        raise BackendError(f"backend {task.backend!r}: {error} {where}") from None
    except BaseException as error:
        raise BackendError(
            f"backend {task.backend!r} raised {type(error).__name__}: {error} {where}"
        ) from None
    if not isinstance(trace, Trace):
        raise BackendError(f"backend {task.backend!r} returned a {type(trace).__name__} and no Trace {where}")
    try:
        json.dumps(dict(trace.meta))
    except TypeError as error:
        raise BackendError(
            f"backend {task.backend!r}: the trace's meta cannot be written: {error} {where}"
        ) from None
    if task.channels is not None:
        trace = trace.only(task.channels)
    return trace, perf_counter() - start


def process_pool(workers: int) -> ExecutorFactory:
    """Return a factory of pools of fresh (spawned) processes, one thread each.

    Spawned, because a forked copy of a process that has run torch or a
    simulator may hang; one thread each, because the rollouts are the parallelism.
    """

    def make() -> Executor:
        return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_follow_parent)

    return make


def _follow_parent() -> None:
    """End this worker when its parent is gone; after a kill -9 it would wait for work for ever."""
    parent = parent_process()
    if parent is not None:

        def watch() -> None:
            parent.join()
            os._exit(1)

        Thread(target=watch, daemon=True).start()


class Runner:
    """Runs tasks on a pool, and makes a new pool when one breaks. A context manager."""

    def __init__(self, factory: ExecutorFactory) -> None:
        self._factory = factory
        self._pool: Executor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        self._close()

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Yield every task's outcome as it arrives, in no promised order.

        Raises:
            S2RError: a rollout raised. What arrived before was yielded; what is in flight is abandoned.
        """
        suspects: list[Task] = []
        for task, outcome in self._attempt(tasks):
            if isinstance(outcome, BrokenExecutor):
                suspects.append(task)
            else:
                yield outcome
        # Sorted, so that a run with a crash in it is as repeatable as one without.
        for task in sorted(suspects, key=lambda task: (task.query, task.replicate)):
            yield self._alone(task)

    def _alone(self, task: Task) -> Done:
        for _ in range(STRIKES):
            for _, outcome in self._attempt([task]):
                if isinstance(outcome, Done):
                    return outcome
        return Done(task, None, 0.0, crash=f"the worker died {STRIKES} times")

    def _attempt(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Done | BrokenExecutor]]:
        if self._pool is None:
            self._pool = self._start()
        waiting: dict[Future[tuple[Trace, float]], Task] = {}
        broken = False
        for task in tasks:
            try:
                with _one_thread():
                    waiting[self._pool.submit(run_task, task)] = task
            except BrokenExecutor as error:
                broken = True
                yield task, error
        try:
            while waiting:
                finished, _ = wait(waiting, return_when=FIRST_COMPLETED)
                failed: S2RError | None = None
                for future in finished:
                    task = waiting.pop(future)
                    try:
                        trace, seconds = future.result()
                    except BrokenExecutor as error:
                        broken = True
                        yield task, error
                    except S2RError as error:
                        failed = error
                    else:
                        yield task, Done(task, trace, seconds)
                if failed is not None:  # only now: what finished beside it is recorded first
                    raise failed
        finally:
            for future in waiting:
                future.cancel()
            if broken:
                self._close()

    def _start(self) -> Executor:
        """Make a pool and see that it works, so that a pool that cannot start is not taken for a crash."""
        with _one_thread():
            pool = self._factory()
            try:
                pool.submit(os.getpid).result()
            except BrokenExecutor as error:
                pool.shutdown(wait=True)
                raise BackendError(
                    "worker processes cannot start; a script that calls s2r must do so below "
                    "`if __name__ == '__main__':`, and be a file"
                ) from error
        return pool

    def _close(self) -> None:
        if self._pool is not None:
            # Waits: CPython 3.11's manager thread can crash on a broken pool that is not waited for.
            self._pool.shutdown(wait=True)
            self._pool = None


@contextmanager
def _one_thread() -> Iterator[None]:
    """Hand OMP_NUM_THREADS=1 to the processes started meanwhile, which read it when they import numpy."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
