"""What runs in a worker's process: it answers one call after another until its parent is gone.

A backend may fork here, spawn, print and read. So the pipes to the parent are no standard streams, are closed in
what is forked and in what is spawned, and have no buffer whose lock a thread could hold while another one forks.
"""

from __future__ import annotations

import atexit
import math
import os
import pickle
import signal
import sys
import traceback
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Thread
from time import sleep
from typing import IO

from s2r_spec.errors import BackendError
from s2r_spec.rollouts import frames

IDLE = 600.0
"""Budget: a worker that nobody asks for anything for so long ends itself [s]: its client may have been killed. Twice
as much keeps the memory of such a worker for twice as long."""
ALONE = 3.0
"""Budget: what a call may take when the parent is gone, before the worker kills its group [s]. Longer than the parent
and the group's guard wait (see ``child.PATIENCE`` and ``group.GRACE``): they are politer."""

_answers: IO[bytes] | None = None
_questions: IO[bytes] | None = None
_number = 0  # of the call that is running
_own = 0  # process id of the worker; 0 in a process that is none


def limit(seconds: float) -> None:
    """Allow the call that is running ``seconds`` from now on, which may be ``inf``.

    Does nothing in a process that is no worker: a thread cannot be ended.
    """
    if _answers is not None and os.getpid() == _own:
        frames.write(_answers, _number, pickle.dumps(("limit", seconds)))


def end_copy(error: BaseException | None = None) -> None:
    """End this process if it is a copy of a worker, forked by a rollout, that came back from that rollout.

    It ends as a program would that raised ``error``, or nothing. Its result is nobody's: the worker itself answers.
    """
    if not _own or os.getpid() == _own:
        return
    status = 0 if error is None else 1
    if isinstance(error, SystemExit):
        status = error.code if isinstance(error.code, int) else int(error.code is not None)
    elif error is not None:
        traceback.print_exception(error)
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    os._exit(status & 0xFF)


def serve_forever() -> None:
    """Answer calls until the parent is gone, or has been silent for long."""
    global _answers, _questions, _own, _number
    _own = os.getpid()
    _questions, _answers = (os.fdopen(os.dup(pipe), mode, 0) for pipe, mode in ((0, "rb"), (1, "wb")))
    # What a backend reads is nothing; what it prints must not get in between the answers: it goes to stderr.
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    try:
        os.dup2(2, 1)
    except OSError:  # s2r itself was started without one
        os.dup2(nothing, 1)
    os.close(nothing)
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_forget_parent)
    # Whoever interrupts: it is the parent who decides what becomes of it.
    signal.signal(signal.SIGINT, lambda *_: None)
    if (
        sys.platform != "win32"
    ):  # in the terminal's background: who reads from it gets an error, and is not stopped
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    atexit.register(_take_along)  # the first: it runs after what the backend has registered
    calls: SimpleQueue[tuple[int, bytes] | None] = SimpleQueue()
    Thread(target=_listen, args=(_questions, calls), daemon=True).start()
    while True:
        try:
            call = calls.get(timeout=IDLE)
        except Empty:
            return
        if call is None:
            return
        _number, question = call
        with suppress(BrokenPipeError):
            limit(math.inf)  # says that the call has begun
            answer = _answer(question)
            end_copy()
            frames.write(_answers, _number, answer)


def _forget_parent() -> None:
    """Close the pipes in a copy that was forked: it could keep them open, and write in between."""
    global _answers
    for pipe in (_answers, _questions):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    _answers = None


def _listen(questions: IO[bytes], calls: SimpleQueue[tuple[int, bytes] | None]) -> None:
    """Queue what the parent asks; when it is gone, end this process and its group, whatever it is at."""
    reader = frames.Reader(questions)
    with suppress(EOFError, OSError, frames.ForeignBytesError):
        while True:
            calls.put(reader.read())
    calls.put(None)
    sleep(ALONE)
    if _leads_group():
        os.killpg(_own, signal.SIGKILL)
    os._exit(1)


def _take_along() -> None:
    """Ask what this worker has started to end with it."""
    if _leads_group():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        with suppress(OSError):
            os.killpg(_own, signal.SIGTERM)


def _leads_group() -> bool:
    """Return whether this process is the worker, with a process group of its own."""
    return hasattr(os, "killpg") and os.getpid() == _own == os.getpgrp()


def _answer(question: bytes) -> bytes:
    """Run a call, and return what came of it, pickled."""
    try:
        function, arguments = pickle.loads(question)
    except Exception as error:
        # Also what a worker on another machine lacks.
        return _raised(BackendError(f"a worker cannot run this: {type(error).__name__}: {error}"))
    try:
        return pickle.dumps(("returned", function(*arguments)))
    except Exception as error:
        end_copy(error)
        return _raised(error)
    except BaseException as error:
        end_copy(error)
        raise


def _raised(error: Exception) -> bytes:
    try:
        data = pickle.dumps(("raised", error))
        pickle.loads(data)  # some errors go in and do not come out
    except Exception:
        return _raised(BackendError(f"{type(error).__name__}: {error}"))
    return data
