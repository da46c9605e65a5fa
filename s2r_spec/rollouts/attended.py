"""Rollouts of a machine: one at a time, in one worker process on this machine, each after its operator's word.

    begin ─ before ─ rollout ─ after ─ before ─ rollout ─ after ─ … ─ end

The worker is made ready before each ``before``, so that between the operator's word and the machine's motion there is
nothing to wait for.

A rollout is never run again by itself. What ended it decides what is recorded:

    the robot (``trace.failure``), or nothing      an outcome, like any simulator's
    the link, the operator (``meta["void"]``)      void: no outcome; the operator says whether the same test runs again
    its worker died, or took too long              void, "killed"
    the backend raised                             void, "error"; the run ends
    ``NotBegunError``                              no rollout; the operator says whether to try again

While a rollout runs the first Ctrl-C brings the machine to rest, the second does so at once, and the third ends the
worker. The run ends after each of them, with all that was recorded.
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

from s2r_spec.backend import (
    VOID,
    Backend,
    Coming,
    KeepsRaw,
    hands_over,
    is_exclusive,
)
from s2r_spec.errors import BackendError, NotBegunError, S2RError, StoppedError
from s2r_spec.rollouts.attempts import AGAIN, FALL, KILLED, Begun, Void
from s2r_spec.rollouts.attendance import Terms, attendance_of
from s2r_spec.rollouts.child import TimeLimitError, WorkerDiedError
from s2r_spec.rollouts.interrupts import Interrupts
from s2r_spec.rollouts.journal import Journal
from s2r_spec.rollouts.layout import run_of
from s2r_spec.rollouts.pools import ProcessPool
from s2r_spec.rollouts.runner import Done, Runner, Task, prepare, run_task
from s2r_spec.trace import Trace

ERROR = "error"
"""Definition: word of a rollout that the backend ended with an error."""
RAW = "raw"
"""Folder of a journal for what a machine records besides its traces."""
MOST_VOID_IN_A_ROW = 3
"""Budget: void attempts at one rollout of a machine that nobody attends to, before the run ends. Twice as many keep a
machine that is out of order busy for twice as long."""


@contextmanager
def attending(
    runner: Runner, backend: Backend, journal: Journal, terms: Terms, most: int | None
) -> Iterator[Runner | Attending]:
    """Give what runs the rollouts of a backend: the runner itself, or, of a machine, one worker and its operator.

    Args:
        runner: of all others.
        backend: whose rollouts are run.
        journal: of them; of a machine it also has what was begun.
        terms: of a machine.
        most: rollouts that are coming at most, those in the journal included; None if nobody knows.
    """
    if not is_exclusive(backend):
        yield runner
        return
    with Attending(backend, journal, runner.timeout, terms, most) as machine:
        yield machine


class Attending:
    """Runs the tasks of a machine; see the module. A context manager.

    Args:
        backend: the machine.
        journal: gets a line before each rollout begins, and one for each that is void.
        timeout: a rollout that takes longer is ended [s]; None for what each task says.
        terms: what becomes of void rollouts, and who is asked.
        most: rollouts that are coming at most, those in the journal included.
    """

    def __init__(
        self, backend: Backend, journal: Journal, timeout: float | None, terms: Terms, most: int | None
    ) -> None:
        self._backend, self._journal, self._timeout, self._terms = backend, journal, timeout, terms
        self._operator = terms.operator
        self._attended = attendance_of(backend, terms.operator)
        self._alone = bool(getattr(self._attended, "unattended", False))
        self._coming = Coming(None if most is None else max(0, most - len(journal)))
        self._pool: ProcessPool | None = None

    def __enter__(self) -> Self:
        for begun in self._journal.open if hands_over(self._backend) else ():
            self._journal.not_begun(begun, "s2r was killed while the outcome was handed over")
        for begun in self._journal.open if self._terms.void == AGAIN else ():
            self._journal.killed(begun, "s2r was killed during this rollout")
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
            self._operator.say(str(after))  # what ended the run is said by its own error
        finally:
            self._pool.shutdown(wait=True)

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Yield every task's outcome, in order; each is to be recorded before the next is asked for.

        Raises:
            StoppedError: the operator ended the run.
            BackendError: a rollout raised, or could not begin and nobody is there to ask.
        """
        left = {begun.key for begun in self._journal.open}
        for task in tasks:
            if (task.query, task.replicate) in left:  # of a run that was killed, and counts it as a fall
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
        """Try a rollout once; yield its outcome and return True, or return False if there is none.

        ``void`` counts the attempts before that came to nothing.
        """
        with self._resumable():
            pool = self._begun()
            try:
                self._ready(pool, task)
                self._attended.before(task.params)
            except NotBegunError as error:
                self._ask(f"Rollout {_name(task)} did not begin: {error}.", error)
                return False
        with Interrupts() as interrupts:
            answers = getattr(self._attended, "answers", {})
            begun = self._journal.begin((task.query, task.replicate), task.params, task.seed, answers)
            ended = self._ended(task, begun, interrupts)
            trace = ended.trace
            if trace is not None and answers:
                trace = replace(trace, meta={**trace.meta, "answers": dict(answers)})
            outcome = ended.word is None or (self._terms.void == FALL and ended.word != ERROR)
            if ended.not_begun is not None:
                self._journal.not_begun(begun, str(ended.not_begun))
                outcome = False
            elif outcome:
                failure = None if ended.word is None else f"{VOID}: {ended.word}"
                yield Done(task, trace, ended.seconds, failure)
            else:
                assert ended.word is not None
                self._journal.void(Void(begun, ended.word, ended.reason, None, ended.seconds), trace)
        if ended.error is not None:
            raise ended.error
        with self._resumable():
            self._attended.after(trace)
            if interrupts.count:
                raise StoppedError("the operator stopped the run with Ctrl-C")
            if ended.not_begun is not None:
                self._ask(f"Rollout {_name(task)} did not begin: {ended.not_begun}.", ended.not_begun)
            elif not outcome:
                words = f"Rollout {_name(task)} is void ({ended.word}): {ended.reason}."
                too_often = BackendError(
                    f"{void + 1} attempts at rollout {_name(task)} came to nothing, the last by: {ended.reason}"
                )
                self._ask(words, too_often if void + 1 >= MOST_VOID_IN_A_ROW else None)
        return outcome

    def _begun(self) -> ProcessPool:
        """Return the worker; before the first rollout it is started, and the operator's consent asked for."""
        if self._pool is not None:
            return self._pool
        pool = ProcessPool(1)
        try:
            pool.submit(os.getpid).result()
        except BrokenExecutor as error:
            pool.shutdown(wait=True)
            raise BackendError("the worker process cannot start: what it printed above says why") from error
        self._pool = pool
        self._attended.begin(self._coming)
        return pool

    def _ready(self, pool: ProcessPool, task: Task) -> None:
        """Let the worker open the machine's backend: what takes long is done before anything moves.

        Raises:
            NotBegunError: it cannot.
        """
        try:
            pool.submit(prepare, task).result()
        except BrokenExecutor:
            raise NotBegunError("the worker process ended while it got ready") from None
        except TimeLimitError as error:
            raise NotBegunError(f"the worker was not ready within {error.args[0]:g} s") from None

    def _ask(self, words: str, alone: S2RError | None) -> None:
        """Ask whether the same test runs again.

        Args:
            words: what happened.
            alone: what to raise if nobody is there to ask; None to go on.
        """
        if not self._alone:
            self._operator.choose(words, {"a": "the same test again; you are asked before it begins"})
            return
        self._operator.say(words)
        if alone is not None:
            raise type(alone)(f"{alone}; {self._resume()}")

    def _ended(self, task: Task, begun: Begun, interrupts: Interrupts) -> _Ended:
        """Hand a rollout to the worker, and return what came of it.

        Where the test was over before, whatever ends the worker leaves no void rollout: it is handed over again.
        """
        ended = self._handed(task, interrupts)
        if hands_over(self._backend) and ended.word in (KILLED, ERROR):
            return replace(ended, word=None, not_begun=NotBegunError(ended.reason))
        return ended

    def _handed(self, task: Task, interrupts: Interrupts) -> _Ended:
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
                return _Ended(not_begun=NotBegunError("the worker process ended before it began"))
            return _Ended(None, perf_counter() - start, KILLED, "the process that ran it died")
        except TimeLimitError as error:
            if error.args[0] > task.timeout:
                words = f"backend {task.backend!r} did not open within {error.args[0]:g} s"
                return _Ended(not_begun=NotBegunError(words))
            return _Ended(None, error.args[0], KILLED, f"it took longer than {error.args[0]:g} s")
        except S2RError as error:
            return _Ended(None, perf_counter() - start, ERROR, str(error), error=error)
        word = trace.meta.get(VOID)
        if word is None or trace.failure is not None:  # what the robot ended counts, whatever came then
            return _Ended(trace, seconds)
        return _Ended(trace, seconds, str(word), str(trace.meta.get("reason", "no reason was given")))

    def _wait(self, future: Future[Any], interrupts: Interrupts) -> None:
        """Return when the rollout has ended; Ctrl-C meanwhile is for the machine."""
        future.add_done_callback(lambda _: interrupts.events.put(False))
        while interrupts.next():
            count = interrupts.count
            if count > 2:
                self._operator.say("Ctrl-C, the third time: the worker is ended.")
                assert self._pool is not None
                self._pool.shutdown(wait=True)
                continue
            self._operator.say(
                "Ctrl-C, once more: at rest at once."
                if count == 2
                else "Ctrl-C: the machine comes to rest, then the run ends. Once more: at rest at once."
            )
            try:
                self._attended.interrupt(urgent=count == 2)
            except (S2RError, OSError) as error:
                self._operator.say(f"The machine cannot be reached: {error}")

    @contextmanager
    def _resumable(self) -> Iterator[None]:
        """Add to the operator's word how the run goes on."""
        try:
            yield
        except StoppedError as error:
            raise StoppedError(f"{error}; {self._resume()}") from None

    def _resume(self) -> str:
        run = run_of(self._journal.folder, self._journal.header)
        return f"what was recorded is kept, go on with --resume {run}"


@dataclass(frozen=True)
class _Ended:
    """What came of a rollout that was handed over.

    Attributes:
        trace: what was recorded of it.
        seconds: that it took [s].
        word: what ended it, if that was not the robot; None for an outcome.
        reason: the same in a sentence.
        not_begun: why there was no rollout.
        error: that ends the run.
    """

    trace: Trace | None = None
    seconds: float = 0.0
    word: str | None = None
    reason: str = ""
    not_begun: NotBegunError | None = None
    error: S2RError | None = None


def _name(task: Task) -> str:
    return f"{task.query}.{task.replicate}"
