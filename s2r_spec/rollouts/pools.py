"""Pools of workers, here and on other machines: all are `concurrent.futures.Executor`, and no more is asked of one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from uuid import uuid4

from s2r_spec.errors import BackendError, S2RError, UsageError
from s2r_spec.rollouts.child import TimeLimitError, WorkerDiedError, close_children, in_child

ExecutorFactory = Callable[[], Executor]

# How long a scheduler may take to answer, and to have its first worker [s].
ANSWER = 10.0


def process_pool(workers: int) -> ExecutorFactory:
    """Return a factory of pools of fresh processes on this machine, one thread each."""
    return lambda: ProcessPool(workers)


def dask_pool(address: str) -> ExecutorFactory:
    """Return a factory of pools of the workers of a Dask scheduler, such as ``tcp://10.0.0.5:8786``.

    Raises:
        UsageError: Dask is not installed here, or the address is none.
    """
    if find_spec("distributed") is None:
        raise UsageError("--scheduler needs distributed, not installed here; try: pip install 's2r[dask]'")
    if "://" not in address:
        raise UsageError(f"--scheduler {address} is not an address, for example tcp://10.0.0.5:8786")
    return lambda: DaskPool(address)


@contextmanager
def kept_open(factory: ExecutorFactory | None) -> Iterator[ExecutorFactory | None]:
    """Lend one pool, made when first asked for, as often as it is asked for; close it at the end."""
    if factory is None:
        yield None
        return
    made: list[Executor] = []

    def lend() -> Executor:
        if not made:
            made.append(factory())
        return _Lent(made[0])

    try:
        yield lend
    finally:
        for pool in made:
            pool.shutdown(cancel_futures=True)


class _Lent(Executor):
    """A pool that stays open when its borrower is done with it."""

    def __init__(self, pool: Executor) -> None:
        self._pool = pool

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        return self._pool.submit(function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Keep the pool open."""


class ProcessPool(ThreadPoolExecutor):
    """Threads with a child process each."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers, thread_name_prefix="s2r")
        self._run = uuid4().hex

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Call a function in a child process."""
        return super().submit(in_child, self._run, function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the children, also those that are at a call, and then the threads."""
        close_children(self._run)
        super().shutdown(wait, cancel_futures=cancel_futures)


class DaskPool(Executor):
    """The workers of a Dask scheduler; every thread of theirs keeps a child process.

    Not ``Client.get_executor()``: when the scheduler goes away while a result is on its way, its future is never
    settled (distributed 2026.8), and the run would wait for ever.
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
        """Call a function in a child process of some worker."""
        answer: Future[Any] = Future()
        answer.set_running_or_notify_cancel()

        def hand_over(done: Any) -> None:
            try:
                answer.set_result(done.result())
            except BaseException as error:
                answer.set_exception(self._explained(error))
            self._open.discard(done)

        done = self._client.submit(in_child, self._run, function, *arguments, pure=False, **named)
        self._open.add(done)  # Dask forgets what nobody holds
        done.add_done_callback(hand_over)
        return answer

    def _explained(self, error: BaseException) -> BaseException:
        """Return an error of Dask's in s2r's words."""
        if isinstance(error, self._dask.KilledWorker):
            return WorkerDiedError(str(error))
        if isinstance(error, CancelledError | self._dask.comm.CommClosedError):
            return BackendError(
                f"the Dask scheduler at {self._address} is gone; what was recorded is kept, go on with --resume"
            )
        if isinstance(error, S2RError | WorkerDiedError | TimeLimitError):
            return error
        return BackendError(
            f"a worker of {self._address} cannot run rollouts ({type(error).__name__}: {error}); "
            f"it needs the same s2r, with the same backends, as this machine"
        )

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Give the workers back; what they are at is abandoned."""
        if self._client.status == "running":
            with suppress(Exception):  # it may go away at this very moment
                self._client.cancel(list(self._open))
                self._client.run(close_children, self._run)
        else:  # it would log how its reconnecting was cut short; that the scheduler is gone is said
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._client.close()
