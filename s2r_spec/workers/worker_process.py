"""One worker process for each thread that runs rollouts: a crash or a hang in a rollout loses only that rollout.

A thread sends a function to its worker process (:mod:`s2r_spec.workers.worker`) and waits for the result. A worker
that dies is replaced, and only its current call is lost. A call sets its own time limit
(:func:`s2r_spec.workers.worker.limit`); a worker that exceeds it is ended with all its descendants. The thread may
belong to a pool of this process or to a Dask worker on another computer.
"""

from __future__ import annotations

import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from functools import partial
from threading import Lock, Thread, local
from time import monotonic
from typing import Any

from s2r_spec.base.errors import BackendError
from s2r_spec.workers import frames
from s2r_spec.workers.limits import Limit, TimeLimitError, cpu_time
from s2r_spec.workers.pipe_wait import waiter
from s2r_spec.workers.process_group import Process, ProcessGroup

PATIENCE = 1.0
"""Budget: time from the close of a worker's pipe until its group gets a SIGTERM [s]."""
BEGINNING = 60.0
"""Budget: time until a worker must begin a call [s]. A worker that does not was stopped, or cannot start; it is ended,
and the call counts as a worker's death."""

_POLL = 1.0  # interval between two looks at a silent worker [s]
_LOOK = 0.05  # least interval between two looks at a worker's CPU time [s], a few ticks of its clock
_START = (
    "import sys; sys.path[:] = {path!r}; from s2r_spec.workers.worker import serve_forever; serve_forever()"
)
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerDiedError(BrokenExecutor):
    """The process that ran a call ended during it.

    ``begun`` is False if the process certainly did not begin the call.
    """

    def __init__(self, message: str, begun: bool = True) -> None:
        super().__init__(message)
        self.begun = begun


class WorkerProcess:
    """A worker process, for the one thread that owns it."""

    def __init__(self, run: str) -> None:
        self.run = run
        path = [os.path.abspath(folder) for folder in sys.path]
        # Rollouts run in parallel; the libraries inside one must not.
        environment = os.environ | dict.fromkeys(_ONE_THREAD, "1")
        self._group = ProcessGroup([sys.executable, "-c", _START.format(path=path)], environment)
        assert self._group.process.stdin is not None
        assert self._group.process.stdout is not None
        self._questions, answers = self._group.process.stdin, self._group.process.stdout
        self._writable = partial(self._wait, waiter(self._questions, "write"))
        self._answers = frames.Reader(answers, partial(self._wait, waiter(answers, "read")))
        self._number = 0
        # Of the call: its time limit, None before it begins; wall clock and CPU time when the limit was set [s]; and
        # the time of the next look at both [s].
        self._limit: Limit | None = None
        self._start, self._cpu_before, self._deadline = 0.0, 0.0, 0.0
        self._calling = Lock()

    @property
    def pid(self) -> int:
        """Process id of the worker, which is also the id of its process group."""
        return self._group.process.pid

    @property
    def alive(self) -> bool:
        """Whether the worker still runs."""
        return self._group.process.poll() is None

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Run a function in the worker: return its result, or raise its exception.

        Raises:
            WorkerDiedError: the worker ended during the call, or did not begin it.
            TimeLimitError: the call exceeded its own time limit, and the worker was ended.
            BackendError: a rollout wrote into the pipe for the worker's answers.
        """
        question = pickle.dumps((function, arguments))
        with self._calling:
            try:
                kind, value = self._exchange(question)
            except (EOFError, BrokenPipeError, TimeLimitError, frames.ForeignBytesError) as error:
                self.end()
                if isinstance(error, TimeLimitError):
                    raise
                if isinstance(error, frames.ForeignBytesError):
                    raise BackendError(
                        "a rollout wrote into the pipe of its worker's answers; "
                        "a backend may write only to files that it opened itself"
                    ) from None
                raise WorkerDiedError("the worker died", begun=self._limit is not None) from None
        if kind == "raised":
            raise value
        return value

    def _exchange(self, question: bytes) -> tuple[str, Any]:
        """Send a call to the worker; return its answer, ("returned", value) or ("raised", error)."""
        self._number += 1
        self._limit, self._deadline = None, monotonic() + BEGINNING
        frames.write(self._questions, self._number, question, self._writable)
        while True:
            number, data = self._answers.read()
            if number > self._number:
                raise frames.ForeignBytesError
            if number < self._number:
                continue  # a surplus answer to an earlier call
            kind, value = pickle.loads(data)
            if kind == "note":
                _say_once(value)
                continue
            if kind != "limit":
                return kind, value
            self._limit, self._cpu_before = value
            self._start = monotonic()
            self._deadline = self._start + value[0].first

    def _wait(self, ready: Callable[[float], bool]) -> None:
        while True:
            left = self._deadline - monotonic()
            if ready(min(max(left, 0.0), _POLL)):
                return
            if left <= 0:
                self._deadline = self._next_look()
            # A process that it forked may keep its end of the pipe open. Its last answer is still read.
            if not self.alive and not ready(0.0):
                raise EOFError

    def _next_look(self) -> float:
        """Return when to look at the clocks of the call again; it cannot exceed its limit before [s]."""
        if self._limit is None:
            raise EOFError
        elapsed = monotonic() - self._start
        if elapsed >= self._limit.wall:
            raise TimeLimitError(self._limit, elapsed)
        cpu, left = cpu_time(self.pid), math.inf
        if cpu is not None:
            left = self._limit.cpu - (cpu - self._cpu_before)
            if left <= 0:
                raise TimeLimitError(self._limit, elapsed, cpu=True)
        return min(monotonic() + max(left, _LOOK), self._start + self._limit.wall)

    def close(self) -> None:
        """Ask the worker to exit; if it does not, end it with all its descendants. Close its pipes."""
        with suppress(OSError):
            self._questions.close()
        with suppress(subprocess.TimeoutExpired):
            self._group.process.wait(PATIENCE)
        self.end()
        with self._calling:  # a thread that waits for its answer first sees that there is none
            self._group.release()

    def end(self) -> None:
        """End the worker and its group; report the descendants that left the group and still run."""
        if self._group.end():
            for process in self._group.escaped():
                _report(process)

    def disown(self) -> None:
        """Close the pipes in a fork of the process that owns the worker."""
        self._group.disown()


_this_thread = local()
_workers: set[WorkerProcess] = set()
_lock = Lock()
_reported: set[int] = set()
_said: set[str] = set()


def call_in_worker(run: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in the worker process of this thread; see :meth:`WorkerProcess.call`.

    A worker serves only one run, because the modules that it loaded may have changed since. The function can be
    imported by its name, and the arguments can be pickled.
    """
    worker: WorkerProcess | None = getattr(_this_thread, "worker", None)
    if worker is None or worker.run != run or not worker.alive:
        if worker is not None:
            _remove(worker)
        _this_thread.worker = worker = WorkerProcess(run)
        with _lock:
            _workers.add(worker)
    return worker.call(function, *arguments)


def end_workers(run: str | None = None) -> None:
    """End the workers of a run, or all workers of this process; their current calls raise WorkerDiedError."""
    with _lock:
        ours = [worker for worker in _workers if run in (None, worker.run)]
    threads = [Thread(target=_remove, args=(worker,)) for worker in ours]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _remove(worker: WorkerProcess) -> None:
    worker.close()
    with _lock:
        _workers.discard(worker)


def _say_once(sentence: str) -> None:
    with _lock:
        known = sentence in _said
        _said.add(sentence)
    if not known:
        print(sentence, file=sys.stderr)


def _report(process: Process) -> None:
    with _lock:
        known = process.pid in _reported
        _reported.add(process.pid)
    if not known:
        print(
            f"note: a rollout started process {process.pid} ({process.command}), which left its process group and "
            f"still runs; end it if it is no longer needed",
            file=sys.stderr,
        )


def _disown() -> None:
    global _lock
    _lock = Lock()
    for worker in _workers:
        worker.disown()
    _workers.clear()
    _this_thread.__dict__.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disown)
