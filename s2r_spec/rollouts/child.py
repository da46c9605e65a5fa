"""A process of its own for each thread that runs rollouts: what dies or hangs in it takes nobody along.

A thread hands a function to its child process and waits. A child that dies is
replaced, and only the call that it was at is lost; one that takes longer than
the call itself allowed (:func:`limit`) is ended. The thread may belong to a pool
of this process or to a Dask worker on another machine: to both this is the same.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Lock, Thread, Timer, local
from time import sleep
from typing import IO, Any

from s2r_spec.errors import BackendError

# A worker that nobody asks for anything any more ends itself [s]: its client may have been killed.
IDLE = 600.0
# How long a child may take to leave when it is asked to [s].
PATIENCE = 2.0

_START = (
    "import sys; sys.path[:] = {path!r}; from s2r_spec.rollouts.child import serve_forever; serve_forever()"
)
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerDiedError(BrokenExecutor):
    """The process that ran a call ended in the middle of it."""


class TimeLimitError(Exception):
    """A call took longer than it allowed itself [s], and its process was ended."""


class Child:
    """One child process, as the thread that owns it sees it."""

    def __init__(self, run: str) -> None:
        self.run = run
        path = [os.path.abspath(folder) for folder in sys.path]
        self._process = subprocess.Popen(
            [sys.executable, "-c", _START.format(path=path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # The rollouts are the parallelism.
            env=os.environ | dict.fromkeys(_ONE_THREAD, "1"),
        )

    @property
    def alive(self) -> bool:
        """Whether it can be called."""
        return self._process.poll() is None

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what the function returns in the child, or raise what it raises there.

        Raises:
            WorkerDiedError: the child ended meanwhile.
            TimeLimitError: the call took longer than it allowed itself, and the child was ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        timer: Timer | None = None
        expired: list[float] = []
        try:
            with suppress(BrokenPipeError):  # its end is seen below
                _write(self._process.stdin, pickle.dumps((function, arguments)))
            while True:
                kind, value = pickle.loads(_read(self._process.stdout))
                if timer is not None:
                    timer.cancel()
                if kind == "limit":
                    timer = self._expire_after(value, expired) if math.isfinite(value) else None
                elif kind == "returned":
                    return value
                else:
                    raise value
        except EOFError:
            self.kill()
            if expired:
                raise TimeLimitError(expired[0]) from None
            raise WorkerDiedError("the worker died") from None
        finally:
            if timer is not None:
                timer.cancel()
            if expired:  # it finished in the moment that it was ended
                self.kill()

    def _expire_after(self, seconds: float, expired: list[float]) -> Timer:
        def expire() -> None:
            expired.append(seconds)
            self._process.kill()

        timer = Timer(seconds, expire)
        timer.daemon = True
        timer.start()
        return timer

    def close(self) -> None:
        """Ask the child to leave, and end it if it does not."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.kill()

    def kill(self) -> None:
        """End the child."""
        self._process.kill()
        self._process.wait()

    def release(self) -> None:
        """Close what is left of a child that has ended."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


_mine = local()
_children: set[Child] = set()
_lock = Lock()


def in_child(run: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in the child process of this thread; see :meth:`Child.call`.

    Args:
        run: a child is used for one run only, for what it has loaded may have changed since.
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
    """End the children of a run, or all of this process; a call that one is at raises WorkerDiedError."""
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


# -- in the child --------------------------------------------------------------------------------

_answers: IO[bytes] | None = None


def limit(seconds: float) -> None:
    """Allow the call that is running ``seconds`` from now on, which may be ``inf``.

    Does nothing in a process that is no child: a thread cannot be ended.
    """
    if _answers is not None:
        _write(_answers, pickle.dumps(("limit", seconds)))


def serve_forever() -> None:
    """Answer calls until the parent is gone, or has been silent for long."""
    global _answers
    # What a backend prints must not get in between the answers: it goes to stderr.
    _answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    # Ctrl-C reaches the whole process group; it is the parent who decides what becomes of it.
    signal.signal(signal.SIGINT, lambda *_: None)
    calls: SimpleQueue[bytes | None] = SimpleQueue()
    Thread(target=_listen, args=(sys.stdin.buffer, calls), daemon=True).start()
    while True:
        try:
            call = calls.get(timeout=IDLE)
        except Empty:
            return
        if call is None:
            return
        with suppress(BrokenPipeError):
            _write(_answers, _answer(call))


def _listen(questions: IO[bytes], calls: SimpleQueue[bytes | None]) -> None:
    """Queue what the parent asks; when it is gone, end this process, whatever it is at."""
    with suppress(EOFError):
        while True:
            calls.put(_read(questions))
    calls.put(None)
    sleep(PATIENCE / 2)
    os._exit(1)


def _answer(call: bytes) -> bytes:
    """Run a call, and return what came of it, pickled."""
    try:
        function, arguments = pickle.loads(call)
    except Exception as error:
        # Also what a worker on another machine lacks.
        return _raised(BackendError(f"a worker cannot run this: {type(error).__name__}: {error}"))
    try:
        return pickle.dumps(("returned", function(*arguments)))
    except Exception as error:
        return _raised(error)


def _raised(error: Exception) -> bytes:
    try:
        data = pickle.dumps(("raised", error))
        pickle.loads(data)  # some errors go in and do not come out
    except Exception:
        return _raised(BackendError(f"{type(error).__name__}: {error}"))
    return data


def _write(file: IO[bytes], data: bytes) -> None:
    file.write(len(data).to_bytes(8, "big"))
    file.write(data)
    file.flush()


def _read(file: IO[bytes]) -> bytes:
    head = file.read(8)
    size = int.from_bytes(head, "big")
    data = file.read(size)
    if len(head) < 8 or len(data) < size:
        raise EOFError
    return data
