"""The program of a worker process: it answers one call after another until its parent is gone.

A backend may fork, spawn, print and read here. So the pipes to the parent are not standard streams, and forks and
spawned processes close them. They have no buffer, because a thread could hold its lock while another thread forks.
"""

from __future__ import annotations

import atexit
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

from s2r_spec import compiled
from s2r_spec.base.errors import BackendError
from s2r_spec.workers import frames
from s2r_spec.workers.limits import Limit, own_cpu_time

IDLE = 600.0
"""Budget: time without a call after which a worker ends itself [s], because its client may have been killed."""
ALONE = 3.0
"""Budget: time from the parent's end until the worker kills its group [s]. It is longer than ``PATIENCE`` of
``worker_process`` and ``GRACE`` of ``process_group``, because those send SIGTERM first."""

_answers: IO[bytes] | None = None
_questions: IO[bytes] | None = None
_number = 0  # of the current call
_own = 0  # process id of the worker; 0 in any other process


def limit(value: Limit) -> None:
    """Set the time limit of the current call, from now on; outside a worker process nothing can be ended."""
    if _answers is not None and os.getpid() == _own:
        frames.write(_answers, _number, pickle.dumps(("limit", (value, own_cpu_time()))))


def say(sentence: str) -> None:
    """Have the parent of this worker process print a sentence, once for all its workers."""
    if _answers is not None and os.getpid() == _own:
        frames.write(_answers, _number, pickle.dumps(("note", sentence)))


def end_copy(error: BaseException | None = None) -> None:
    """End this process if it is a fork of the worker that returned from the rollout that forked it.

    It exits like a program that raised ``error``, or none. Only the worker itself may answer the call.
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
    """Answer calls until the parent is gone, or has sent none for ``IDLE``."""
    global _answers, _questions, _own, _number
    _own = os.getpid()
    _questions, _answers = (os.fdopen(os.dup(pipe), mode, 0) for pipe, mode in ((0, "rb"), (1, "wb")))
    # A backend reads an empty standard input. Its output goes to stderr, so that it cannot mix with the answers.
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    try:
        os.dup2(2, 1)
    except OSError:  # s2r itself was started without stderr
        os.dup2(nothing, 1)
    os.close(nothing)
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_forget_parent)
    compiled.say = say
    # The parent decides how an interrupt ends a rollout.
    signal.signal(signal.SIGINT, lambda *_: None)
    if (
        sys.platform != "win32"
    ):  # in the background of a terminal: a read fails instead of stopping the process
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    atexit.register(_end_group)  # registered first, so it runs after the backend's own handlers
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
            limit(Limit())  # tells the parent that the call has begun
            answer = _answer(question)
            end_copy()
            frames.write(_answers, _number, answer)


def _forget_parent() -> None:
    """Close the pipes in a fork: it could keep them open, or write between two answers."""
    global _answers
    for pipe in (_answers, _questions):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    _answers = None


def _listen(questions: IO[bytes], calls: SimpleQueue[tuple[int, bytes] | None]) -> None:
    """Queue the parent's calls; when the parent is gone, end this process and its group, even during a call."""
    reader = frames.Reader(questions)
    with suppress(EOFError, OSError, frames.ForeignBytesError):
        while True:
            calls.put(reader.read())
    calls.put(None)
    sleep(ALONE)
    if _leads_group():
        os.killpg(_own, signal.SIGKILL)
    os._exit(1)


def _end_group() -> None:
    """Send SIGTERM to the worker's descendants when the worker exits."""
    if _leads_group():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        with suppress(OSError):
            os.killpg(_own, signal.SIGTERM)


def _leads_group() -> bool:
    return hasattr(os, "killpg") and os.getpid() == _own == os.getpgrp()


def _answer(question: bytes) -> bytes:
    try:
        function, arguments = pickle.loads(question)
    except Exception as error:
        # For instance, a worker on another computer lacks a module.
        return _pickle_error(BackendError(f"a worker cannot run this: {type(error).__name__}: {error}"))
    try:
        return pickle.dumps(("returned", function(*arguments)))
    except Exception as error:
        end_copy(error)
        return _pickle_error(error)
    except BaseException as error:
        end_copy(error)
        raise


def _pickle_error(error: Exception) -> bytes:
    try:
        data = pickle.dumps(("raised", error))
        pickle.loads(data)  # some errors can be pickled but not unpickled
    except Exception:
        return _pickle_error(BackendError(f"{type(error).__name__}: {error}"))
    return data
