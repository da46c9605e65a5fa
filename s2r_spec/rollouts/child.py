"""A process of its own for each thread that runs rollouts: what dies or hangs in it takes nobody along.

A thread hands a function to its worker process (:mod:`s2r_spec.rollouts.worker`) and waits. A worker that dies is
replaced, and only the call that it was at is lost; one that takes longer than the call itself allowed
(:func:`s2r_spec.rollouts.worker.limit`) is ended, with all that it started. The thread may belong to a pool of this
process or to a Dask worker on another machine: to both this is the same.
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

from s2r_spec.errors import BackendError
from s2r_spec.rollouts import frames
from s2r_spec.rollouts.group import Group, Process
from s2r_spec.rollouts.ready import waits_for

PATIENCE = 1.0
"""Budget: how long a worker may take to leave when its pipe is closed, before its group is asked to end [s]. Twice as
much delays Ctrl-C by as much in the middle of a long rollout."""
BEGINNING = 60.0
"""Budget: how long a worker may take to begin with a call [s]. One that does not was stopped, or cannot start; it is
ended, and the call counts as a worker's death. Twice as much waits twice as long for it."""

_LOOK = 1.0  # how often a silent worker is looked at [s]
_START = (
    "import sys; sys.path[:] = {path!r}; from s2r_spec.rollouts.worker import serve_forever; serve_forever()"
)
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerDiedError(BrokenExecutor):
    """The process that ran a call ended in the middle of it.

    ``begun`` is False where the process certainly did not begin with the call.
    """

    def __init__(self, sentence: str, begun: bool = True) -> None:
        super().__init__(sentence)
        self.begun = begun


class TimeLimitError(Exception):
    """A call took longer than it allowed itself [s], and its process was ended."""


class Child:
    """One worker process, as the thread that owns it sees it."""

    def __init__(self, run: str) -> None:
        self.run = run
        path = [os.path.abspath(folder) for folder in sys.path]
        # The rollouts are the parallelism.
        environment = os.environ | dict.fromkeys(_ONE_THREAD, "1")
        self._group = Group([sys.executable, "-c", _START.format(path=path)], environment)
        assert self._group.process.stdin is not None
        assert self._group.process.stdout is not None
        self._questions, answers = self._group.process.stdin, self._group.process.stdout
        self._writable = partial(self._wait, waits_for(self._questions, "write"))
        self._answers = frames.Reader(answers, partial(self._wait, waits_for(answers, "read")))
        self._number = 0
        self._limit, self._deadline = math.nan, math.inf  # what the call may take [s], and until when
        self._calling = Lock()

    @property
    def pid(self) -> int:
        """Process id of the worker, and the number of its process group."""
        return self._group.process.pid

    @property
    def alive(self) -> bool:
        """Whether it can be called."""
        return self._group.process.poll() is None

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what the function returns in the worker, or raise what it raises there.

        Raises:
            WorkerDiedError: the worker ended meanwhile, or did not begin.
            TimeLimitError: the call took longer than it allowed itself, and the worker was ended.
            BackendError: something else than the worker wrote into the pipe of its answers.
        """
        question = pickle.dumps((function, arguments))
        with self._calling:
            try:
                kind, value = self._ask(question)
            except (EOFError, BrokenPipeError):
                self.end()
                raise WorkerDiedError("the worker died", begun=not math.isnan(self._limit)) from None
            except TimeLimitError:
                self.end()
                raise
            except frames.ForeignBytesError:
                self.end()
                raise BackendError(
                    "a rollout wrote into the pipe of its worker's answers; "
                    "a backend may write only to files that it opened itself"
                ) from None
        if kind == "raised":
            raise value
        return value

    def _ask(self, question: bytes) -> tuple[str, Any]:
        """Return ("returned", value) or ("raised", error), as the worker answers."""
        self._number += 1
        self._limit, self._deadline = math.nan, monotonic() + BEGINNING
        frames.write(self._questions, self._number, question, self._writable)
        while True:
            number, data = self._answers.read()
            if number > self._number:
                raise frames.ForeignBytesError
            if number < self._number:
                continue  # an answer too many, to an earlier call
            kind, value = pickle.loads(data)
            if kind != "limit":
                return kind, value
            self._limit, self._deadline = value, monotonic() + value

    def _wait(self, ready: Callable[[float], bool]) -> None:
        """Return when the worker can be written to or read from.

        Raises:
            EOFError: it has ended, or did not begin in time.
            TimeLimitError: the call has taken as long as it may.
        """
        while True:
            left = self._deadline - monotonic()
            if ready(min(max(left, 0.0), _LOOK)):
                return
            if left <= 0:
                raise EOFError if math.isnan(self._limit) else TimeLimitError(self._limit)
            # What it forked may keep its end of the pipe open. What it still said is read.
            if not self.alive and not ready(0.0):
                raise EOFError

    def close(self) -> None:
        """Ask the worker to leave, and end it if it does not, with all that it started."""
        with suppress(OSError):
            self._questions.close()
        with suppress(subprocess.TimeoutExpired):
            self._group.process.wait(PATIENCE)
        self.end()

    def end(self) -> None:
        """End the worker and all that it started, and name what left its group and still runs."""
        if self._group.end():
            for process in self._group.left():
                _name(process)

    def release(self) -> None:
        """Close what is left of a worker that has ended."""
        with self._calling:  # who waits for its answer sees first that there is none
            self._group.release()

    def disown(self) -> None:
        """Close the pipes in a process that was forked from the one that owns the worker."""
        self._group.disown()


_mine = local()
_children: set[Child] = set()
_lock = Lock()
_named: set[int] = set()


def in_child(run: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in the worker process of this thread; see :meth:`Child.call`.

    Args:
        run: a worker is used for one run only, for what it has loaded may have changed since.
        function: importable by its name.
        arguments: anything that can be pickled.
    """
    child: Child | None = getattr(_mine, "child", None)
    if child is None or child.run != run or not child.alive:
        if child is not None:
            _forget(child)
        _mine.child = child = Child(run)
        with _lock:
            _children.add(child)
    return child.call(function, *arguments)


def close_children(run: str | None = None) -> None:
    """End the workers of a run, or all of this process; a call that one is at raises WorkerDiedError."""
    with _lock:
        ours = [child for child in _children if run in (None, child.run)]
    leaving = [Thread(target=_forget, args=(child,)) for child in ours]
    for thread in leaving:
        thread.start()
    for thread in leaving:
        thread.join()


def _forget(child: Child) -> None:
    child.close()
    child.release()
    with _lock:
        _children.discard(child)


def _name(process: Process) -> None:
    """Say once that a process has left the group of its rollout."""
    with _lock:
        known = process.pid in _named
        _named.add(process.pid)
    if not known:
        print(
            f"note: process {process.pid} ({process.command}) was started by a rollout, left its process group "
            f"and still runs; end it yourself if nobody needs it",
            file=sys.stderr,
        )


def _disown() -> None:
    """Leave all workers to the process that this one was forked from."""
    global _lock
    _lock = Lock()
    for child in _children:
        child.disown()
    _children.clear()
    _mine.__dict__.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disown)
