"""Run rollouts on any `concurrent.futures.Executor`, even if its workers die.

In the pools of :mod:`s2r_spec.workers.pools` a dead worker loses only its own rollout. Other pools may fail all
running rollouts. So the runner takes a factory of pools: it makes a new pool and repeats these rollouts one at a
time. A rollout that breaks its worker three times is recorded as a crash.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import replace
from typing import Self

from s2r_spec.base.errors import BackendError, S2RError
from s2r_spec.runs.task import Done, Task, run_task
from s2r_spec.trace import Trace
from s2r_spec.workers.limits import TimeLimitError
from s2r_spec.workers.pools import ExecutorFactory
from s2r_spec.workers.worker_process import WorkerDiedError

STRIKES = 3
"""Budget: workers that a rollout may break before it counts as a crash."""
Call = Callable[[Task], tuple[Trace, float]]
"""Runs a task in a worker, and returns its trace and the seconds it took, as :func:`run_task` does."""


class Runner:
    """Runs tasks on a pool, and makes a new pool when one breaks. A context manager.

    ``timeout`` is the limit of a rollout, as of a :class:`Task` [s], ``inf`` for none; None for that of each task.
    """

    def __init__(self, factory: ExecutorFactory, timeout: float | None = None) -> None:
        self._factory, self.timeout = factory, timeout
        self._pool: Executor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._close()

    def run(self, tasks: Sequence[Task], call: Call = run_task) -> Iterator[Done]:
        """Yield the outcome of every task as it arrives, in any order; ``call`` must pickle.

        Raises:
            S2RError: a rollout raised it. Earlier outcomes were yielded; running rollouts are abandoned.
        """
        if self.timeout is not None:
            tasks = [replace(task, timeout=self.timeout) for task in tasks]
        suspects: list[Task] = []
        for task, outcome in self._attempt(tasks, call):
            if isinstance(outcome, BrokenExecutor):
                suspects.append(task)
            else:
                yield outcome
        # Sorted, so that a run with a crash in it is as repeatable as one without.
        for task in sorted(suspects, key=lambda task: (task.query, task.replicate)):
            yield self._alone(task, call)

    def _alone(self, task: Task, call: Call) -> Done:
        for _ in range(STRIKES):
            for _, outcome in self._attempt([task], call):
                if isinstance(outcome, Done):
                    return outcome
        return Done(task, None, 0.0, f"crash: the worker died {STRIKES} times")

    def _attempt(self, tasks: Iterable[Task], call: Call) -> Iterator[tuple[Task, Done | BrokenExecutor]]:
        if self._pool is None:
            self._pool = self._start()
        waiting: dict[Future[tuple[Trace, float]], Task] = {}
        broken = False
        for task in tasks:
            try:
                waiting[self._pool.submit(call, task)] = task
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
                        broken = broken or not isinstance(error, WorkerDiedError)
                        yield task, error
                    except TimeLimitError as error:
                        if error.limit.opening:  # the rollout never ran
                            words = f"backend {task.backend!r} did not open within {error.words}"
                            raise BackendError(words) from None
                        failure = f"crash: no answer within {error.words}"
                        yield task, Done(task, None, error.elapsed, failure)
                    except S2RError as error:
                        failed = error
                    else:
                        yield task, Done(task, trace, seconds)
                if failed is not None:  # after the others that have finished, so that they are recorded
                    raise failed
        finally:
            for future in waiting:
                future.cancel()
            if broken:
                self._close()

    def _start(self) -> Executor:
        """Make a pool and check that it works, so that a pool that cannot start does not count as a crash."""
        pool = self._factory()
        try:
            pool.submit(os.getpid).result()
        except BrokenExecutor as error:
            pool.shutdown(wait=True)
            raise BackendError("worker processes cannot start; their output above says why") from error
        except BaseException:  # Ctrl-C included
            pool.shutdown(wait=True)
            raise
        return pool

    def _close(self) -> None:
        if self._pool is not None:
            # wait=True: without it, CPython 3.11's manager thread can crash on a broken pool.
            self._pool.shutdown(wait=True)
            self._pool = None
