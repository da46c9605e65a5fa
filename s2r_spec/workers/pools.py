"""Pools of workers on this computer and on others; each is a `concurrent.futures.Executor`."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    as_completed,
)
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any, TypeVar
from uuid import uuid4

from s2r_spec.base.errors import BackendError, S2RError, UsageError, require
from s2r_spec.workers.limits import TimeLimitError
from s2r_spec.workers.worker_process import WorkerDiedError, call_in_worker, end_workers

K = TypeVar("K")
T = TypeVar("T")
ExecutorFactory = Callable[[], Executor]

ANSWER = 10.0
"""Budget: time for a scheduler to answer, and time for its first worker [s]."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def process_pool(workers: int) -> ExecutorFactory:
    """Return a factory of pools of new processes on this computer, one thread each."""
    return lambda: ProcessPool(workers)


def in_this_process() -> Executor:
    """Return a pool of one thread of this process, which knows every class of a notebook; it cannot end a rollout."""
    return ThreadPoolExecutor(1, thread_name_prefix="s2r")


def dask_pool(address: str) -> ExecutorFactory:
    """Return a factory of pools on a Dask scheduler, such as ``tcp://10.0.0.5:8786``; a UsageError without Dask."""
    require("--scheduler needs", "distributed")
    if "://" not in address:
        raise UsageError(f"--scheduler {address} is not an address such as tcp://10.0.0.5:8786")
    return lambda: DaskPool(address)


@contextmanager
def keep_open(factory: ExecutorFactory | None) -> Iterator[ExecutorFactory | None]:
    """Give a factory that always returns the same pool, made at the first call; close the pool at the end."""
    if factory is None:
        yield None
        return
    pools: list[Executor] = []

    def shared() -> Executor:
        if not pools:
            pools.append(factory())
        return _SharedPool(pools[0])

    try:
        yield shared
    finally:
        for pool in pools:
            pool.shutdown(cancel_futures=True)


def as_they_end(
    factory: ExecutorFactory | None,
    function: Callable[..., T],
    jobs: Mapping[K, tuple[Any, ...]],
    during: str,
) -> Iterator[tuple[K, T]]:
    """Yield key and ``function(*arguments)`` of each job, as they end; without a pool in this thread, in their order.

    Raises:
        BackendError: a worker died; the sentence says ``during`` what.
    """
    if factory is None:
        for key, arguments in jobs.items():
            yield key, function(*arguments)
        return
    with factory() as pool:
        pending = {pool.submit(function, *arguments): key for key, arguments in jobs.items()}
        try:
            for future in as_completed(pending):
                yield pending[future], future.result()
        except BrokenExecutor:
            raise BackendError(
                f"a worker died while it {during}; run it again with --workers 1 to see the rollout that kills it"
            ) from None
        finally:
            for future in pending:
                future.cancel()


class _SharedPool(Executor):
    """A pool that ignores ``shutdown``, because other callers still use it."""

    def __init__(self, pool: Executor) -> None:
        self._pool = pool

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        return self._pool.submit(function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Do nothing."""


class ProcessPool(ThreadPoolExecutor):
    """Threads, each with a worker process."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers, thread_name_prefix="s2r")
        self._run = uuid4().hex

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Call a function in a worker process."""
        return super().submit(call_in_worker, self._run, function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the worker processes, even during a call, and then the threads."""
        end_workers(self._run)
        super().shutdown(wait, cancel_futures=cancel_futures)


class DaskPool(Executor):
    """The workers of a Dask scheduler; each of their threads has a worker process.

    ``Client.get_executor()`` does not serve: if the scheduler is lost before a result arrives, its future never ends
    (distributed 2026.8), and the run would wait forever.
    """

    def __init__(self, address: str) -> None:
        self._dask = import_module("distributed")
        self._address, self._run = address, uuid4().hex
        try:
            self._client = self._dask.Client(address, timeout=ANSWER, set_as_default=False)
        except (OSError, ValueError) as error:
            raise BackendError(f"no Dask scheduler answers at {address}: {error}") from None
        try:
            self._client.wait_for_workers(1, timeout=ANSWER)
        except TimeoutError:
            self._client.close()
            raise BackendError(f"the Dask scheduler at {address} has no workers; start some") from None
        self._open: set[Any] = set()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Call a function in a worker process of one of Dask's workers."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()

        def copy_result(done: Any) -> None:
            try:
                future.set_result(done.result())
            except BaseException as error:
                future.set_exception(self._explained(error))
            self._open.discard(done)

        remote = self._client.submit(call_in_worker, self._run, function, *arguments, pure=False, **named)
        self._open.add(remote)  # Dask cancels a future that has no reference
        remote.add_done_callback(copy_result)
        return future

    def _explained(self, error: BaseException) -> BaseException:
        if isinstance(error, self._dask.KilledWorker):
            return WorkerDiedError(str(error))
        if isinstance(error, CancelledError | self._dask.comm.CommClosedError):
            return BackendError(
                f"the connection to the Dask scheduler at {self._address} was lost; all recorded rollouts are kept, "
                f"go on with --resume"
            )
        if isinstance(error, S2RError | WorkerDiedError | TimeLimitError):
            return error
        return BackendError(
            f"a worker of {self._address} cannot run rollouts ({type(error).__name__}: {error}); "
            f"install the same s2r and the same backends there as here"
        )

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Release the workers, and abandon their current calls."""
        if self._client.status == "running":
            with suppress(Exception):  # the connection may be lost at this moment
                self._client.cancel(list(self._open))
                self._client.run(end_workers, self._run)
        else:  # Dask would log that its reconnection was interrupted; the error above says enough
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._client.close()
