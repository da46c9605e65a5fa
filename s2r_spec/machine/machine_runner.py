"""Run rollouts on a machine: one at a time, in one worker process of this computer, each confirmed by the operator.

    begin ─ before ─ rollout ─ after ─ before ─ rollout ─ after ─ … ─ end

The worker opens the backend before each ``before``, so the machine moves as soon as the operator confirms.

No rollout is repeated automatically. The cause of its end decides what the journal records:

    the robot (``trace.failure``), or nothing      an outcome, as of a simulator
    the link, the operator (``meta["void"]``)      void: no outcome; the operator may run the same test again
    the worker died, or the time limit passed      void, "killed"
    the backend raised an error                    void, "error"; the run ends
    ``NotBegunError``                              no rollout; the operator may try again

During a rollout the first Ctrl-C brings the machine to rest, the second does so at once, and the third ends the
worker. The run ends after each of them, and keeps everything recorded so far.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter
from types import TracebackType
from typing import Any, Self

from s2r_spec.backend import VOID, Backend, Coming, KeepsRaw, hands_over, is_exclusive
from s2r_spec.backend.protocols import AttendsProtocols, protocol_of
from s2r_spec.base.errors import BackendError, NotBegunError, S2RError, StoppedError
from s2r_spec.machine.attendance import Terms, attendance_of
from s2r_spec.machine.interrupts import Interrupts
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.layout import run_of
from s2r_spec.runs.machine_journal import AGAIN, FALL, KILLED, Void
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.task import Done, Task, prepare, run_task
from s2r_spec.trace import Trace
from s2r_spec.workers.limits import TimeLimitError
from s2r_spec.workers.pools import ProcessPool
from s2r_spec.workers.worker_process import WorkerDiedError

ERROR = "error"
"""Definition: the word for a rollout in which the backend raised an error."""
RAW = "raw"
"""Folder in a journal's folder for recordings of a machine other than its traces."""
MOST_VOID_IN_A_ROW = 3
"""Budget: void attempts in a row at one rollout of an unattended machine, before the run ends."""


@contextmanager
def runner_for(
    runner: Runner, backend: Backend, journal: Journal, terms: Terms, most: int | None
) -> Iterator[Runner | MachineRunner]:
    """Give the runner for a backend: the given one for a simulator, a :class:`MachineRunner` for a machine."""
    if not is_exclusive(backend):
        yield runner
        return
    with MachineRunner(backend, journal, runner.timeout, terms, most) as machine:
        yield machine


class MachineRunner:
    """Runs tasks on a machine, as the module describes. A context manager.

    ``timeout`` is the limit of a rollout [s]; None for that of each task. ``most`` is the largest number of rollouts in
    the run, with those in the journal; None if unknown.
    """

    def __init__(
        self, backend: Backend, journal: Journal, timeout: float | None, terms: Terms, most: int | None
    ) -> None:
        self._backend, self._journal, self._timeout, self._terms = backend, journal, timeout, terms
        self._operator = terms.operator
        self._attended = attendance_of(backend, terms.operator)
        self._unattended = bool(getattr(self._attended, "unattended", False))
        self._coming = Coming(None if most is None else max(0, most - len(journal)))
        self._pool: ProcessPool | None = None

    def __enter__(self) -> Self:
        for attempt in self._journal.open if hands_over(self._backend) else ():
            self._journal.not_begun(attempt, "s2r was killed while the outcome was handed over")
        for attempt in self._journal.open if self._terms.void == AGAIN else ():
            self._journal.killed(attempt, "s2r was killed during this rollout")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        if self._pool is None:
            return
        try:
            self._attended.end()
        except KeyboardInterrupt:
            self._attended.interrupt(urgent=True)
            raise
        except S2RError as after:
            if error is None:
                raise
            self._operator.say(str(after))  # the error that ended the run is raised
        finally:
            self._pool.shutdown(wait=True)

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Yield the outcome of every task, in order; the caller records each before it asks for the next.

        Raises:
            StoppedError: the operator ended the run.
            BackendError: a rollout raised an error, or an unattended machine could not begin one.
        """
        interrupted = {attempt.key for attempt in self._journal.open}
        for task in tasks:
            if (task.query, task.replicate) in interrupted:  # s2r was killed in it, and void counts as a fall
                yield Done(task, None, 0.0, f"{VOID}: {KILLED}")
                continue
            void = 0
            while not (yield from self._attempt(self._for_machine(task), void)):
                void += 1

    def _for_machine(self, task: Task) -> Task:
        timeout = task.timeout if self._timeout is None else self._timeout
        raw = None
        if isinstance(self._backend, KeepsRaw):
            (self._journal.folder / RAW).mkdir(exist_ok=True)
            raw = str((self._journal.folder / RAW).absolute())
        return replace(task, timeout=timeout, attended=True, raw=raw)

    def _attempt(self, task: Task, void: int) -> Generator[Done, None, bool]:
        """Attempt a rollout once; yield its outcome and return True, or return False if it has none.

        ``void`` is the number of attempts before this one, all without an outcome.
        """
        with self._resumable():
            pool = self._started()
            try:
                self._ready(pool, task)
                self._before(task)
            except NotBegunError as error:
                self._ask(f"Rollout {_name(task)} did not begin: {error}.", error)
                return False
        with Interrupts() as interrupts:
            answers = getattr(self._attended, "answers", {})
            attempt = self._journal.begin((task.query, task.replicate), task.params, task.seed, answers)
            ended = self._run_rollout(task, interrupts)
            trace = ended.trace
            if trace is not None and answers:
                trace = replace(trace, meta={**trace.meta, "answers": dict(answers)})
            outcome = ended.word is None or (self._terms.void == FALL and ended.word != ERROR)
            if ended.not_begun is not None:
                self._journal.not_begun(attempt, str(ended.not_begun))
                outcome = False
            elif outcome:
                failure = None if ended.word is None else f"{VOID}: {ended.word}"
                yield Done(task, trace, ended.seconds, failure)
            else:
                assert ended.word is not None
                self._journal.void(Void(attempt, ended.word, ended.reason, None, ended.seconds), trace)
        if ended.error is not None:
            raise ended.error
        with self._resumable():
            self._attended.after(trace)
            if interrupts.count:
                raise StoppedError("the operator stopped the run with Ctrl-C")
            if ended.not_begun is not None:
                self._ask(f"Rollout {_name(task)} did not begin: {ended.not_begun}.", ended.not_begun)
            elif not outcome:
                often = f"{void + 1} attempts at rollout {_name(task)} were void, the last one because: {ended.reason}"
                too_often = BackendError(often) if void + 1 >= MOST_VOID_IN_A_ROW else None
                self._ask(f"Rollout {_name(task)} is void ({ended.word}): {ended.reason}.", too_often)
        return outcome

    def _started(self) -> ProcessPool:
        """Return the pool of one worker; at the first call start it, and ask for the operator's consent."""
        if self._pool is not None:
            return self._pool
        pool = ProcessPool(1)
        try:
            pool.submit(os.getpid).result()
        except BrokenExecutor as error:
            pool.shutdown(wait=True)
            raise BackendError("the worker process cannot start; its output above says why") from error
        self._pool = pool
        self._attended.begin(self._coming)
        return pool

    def _ready(self, pool: ProcessPool, task: Task) -> None:
        try:
            pool.submit(prepare, task).result()
        except BrokenExecutor:
            raise NotBegunError("the worker process ended while it opened the backend") from None
        except TimeLimitError as error:
            raise NotBegunError(f"the worker was not ready within {error.words}") from None

    def _before(self, task: Task) -> None:
        if task.protocol is None:
            self._attended.before(task.params)
        elif isinstance(self._attended, AttendsProtocols):
            self._attended.before_protocol(protocol_of(self._backend, task.protocol), task.params)
        else:
            lacks = "prepares tests only; it needs a method before_protocol(protocol, params)"
            raise BackendError(f"the attendance of {self._backend.name!r} {lacks}")

    def _ask(self, message: str, unattended: S2RError | None) -> None:
        """Ask whether the same test runs again; of an unattended machine raise the error, if there is one."""
        if not self._unattended:
            self._operator.choose(message, {"a": "the same test again; you are asked before it begins"})
            return
        self._operator.say(message)
        if unattended is not None:
            raise type(unattended)(f"{unattended}; {self._resume()}")

    def _run_rollout(self, task: Task, interrupts: Interrupts) -> _Ended:
        assert self._pool is not None
        start = perf_counter()
        future = self._pool.submit(run_task, task)
        self._wait(future, interrupts)
        try:
            trace, seconds = future.result()
        except NotBegunError as error:
            return _Ended(not_begun=error)
        except WorkerDiedError as error:
            if not error.begun:
                return _Ended(not_begun=NotBegunError("the worker process ended before the rollout began"))
            ended = _Ended(None, perf_counter() - start, KILLED, "the process that ran the rollout died")
        except TimeLimitError as error:
            if error.limit.opening:
                message = f"backend {task.backend!r} did not open within {error.words}"
                return _Ended(not_begun=NotBegunError(message))
            ended = _Ended(None, error.elapsed, KILLED, f"the rollout took longer than {error.words}")
        except S2RError as error:
            ended = _Ended(None, perf_counter() - start, ERROR, str(error), error=error)
        else:
            word = trace.meta.get(VOID)
            if (
                word is None or trace.failure is not None
            ):  # an end by the robot counts, whatever came after it
                return _Ended(trace, seconds)
            return _Ended(
                trace, seconds, str(word), str(trace.meta.get("reason", "the backend gave no reason"))
            )
        # A backend that hands over a finished test leaves no void rollout: it hands over again.
        return (
            replace(ended, word=None, not_begun=NotBegunError(ended.reason))
            if hands_over(self._backend)
            else ended
        )

    def _wait(self, future: Future[Any], interrupts: Interrupts) -> None:
        future.add_done_callback(lambda _: interrupts.events.put(False))
        while interrupts.next():
            count = interrupts.count
            if count > 2:
                self._operator.say("Third Ctrl-C: s2r ends the worker.")
                assert self._pool is not None
                self._pool.shutdown(wait=True)
                continue
            first = "Ctrl-C: the machine comes to rest, then the run ends. Press it again to stop at once."
            self._operator.say(first if count == 1 else "Second Ctrl-C: the machine stops at once.")
            try:
                self._attended.interrupt(urgent=count == 2)
            except (S2RError, OSError) as error:
                self._operator.say(f"s2r cannot reach the machine: {error}")

    @contextmanager
    def _resumable(self) -> Iterator[None]:
        """Add to a StoppedError how to resume the run."""
        try:
            yield
        except StoppedError as error:
            raise StoppedError(f"{error}; {self._resume()}") from None

    def _resume(self) -> str:
        run = run_of(self._journal.folder, self._journal.header)
        return f"all recorded rollouts are kept; go on with --resume {run}"


@dataclass(frozen=True)
class _Ended:
    """How a rollout ended; ``word`` and ``reason`` are None and "" for an outcome.

    ``not_begun`` is why it did not begin, and ``error`` ends the run.
    """

    trace: Trace | None = None
    seconds: float = 0.0
    word: str | None = None
    reason: str = ""
    not_begun: NotBegunError | None = None
    error: S2RError | None = None


def _name(task: Task) -> str:
    return f"{task.query}.{task.replicate}"
