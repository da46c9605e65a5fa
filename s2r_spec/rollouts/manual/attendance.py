"""The dialogue with the person who runs the tests, in the process that holds the terminal.

A test is asked for until there is a log that fits, or a word for how it ended. What was not begun is no rollout: the
same test is asked again. What was begun counts, whatever came of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from s2r_spec.backend import Coming, Needs, Operator
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.logs import FORMATS
from s2r_spec.rollouts.manual.checks import Question, alike, refusal, what_counts, without_unit
from s2r_spec.rollouts.manual.place import INCOMING, ORIGINALS, REFUSED, Place, Step
from s2r_spec.rollouts.manual.words import channel_words, test_words
from s2r_spec.rollouts.reading import Reading
from s2r_spec.rollouts.recorded import digest
from s2r_spec.trace import Trace

FALL = "fall"
"""Definition: the word for a rollout that the robot ended."""
NO_LOG = "log"
"""Definition: the word for a void rollout that ran and has no log."""


@dataclass(frozen=True)
class _Found:
    """What a file is: the trace of the test, or why it is not; and what its person should know."""

    trace: Trace | None
    why: str | None
    notes: tuple[str, ...] = ()


@dataclass
class Attendance:
    """Asks for tests; see :class:`s2r_spec.backend.Attended`.

    Args:
        place: the folder.
        reading: how logs are read.
        needs: of the specification.
        seconds: that it looks ahead [s]; 0 where it looks at the whole rest of a trace.
        operator: the person.
    """

    place: Place
    reading: Reading
    needs: Needs
    seconds: float
    operator: Operator
    _seen: set[bytes] = field(default_factory=set)
    _noted: set[str] = field(default_factory=set)
    _before: dict[str, float] | None = None

    def begin(self, coming: Coming) -> None:
        """Make the folder ready, and say what is coming.

        Raises:
            UsageError: the folder cannot be used for these tests.
        """
        self._seen = set(self.place.prepare(self.needs.channels, self.needs.parameters, self.seconds))
        count, there = coming.rollouts, self.place.recorded()
        much = "Tests are coming" if count is None else f"At most {count} tests are coming"
        self.operator.say(
            f"{much}, one after the other. You run each on the robot, and put its log into "
            f"{self.place.root / INCOMING}."
            + (f" {there} are recorded in {self.place.root} already." if there else "")
        )
        if self.seconds > 0:
            self.operator.say(
                f"Each takes {self.seconds:g} s from its beginning, the first sample of its log."
            )

    def before(self, params: Mapping[str, float]) -> None:
        """Ask for a test until it has an outcome.

        Raises:
            StoppedError: the person ends the run; the same test is asked when it goes on.
        """
        step = self.place.step()
        if step is not None and step.params != dict(params):
            self._leave(step)
            step = None
        if step is not None and step.log is not None and self._spoilt(step):
            step = None
        if step is not None and step.state != "asked":
            self.operator.say(f"The outcome of {self._test(step)} is there already, as {step.id}.")
            return
        step = step or self.place.new(params)
        self.place.write(step, self._about())
        if (given := self.place.given(step)) is not None and self._try(given, step, None):
            return
        while not self._asked(step):
            pass

    def after(self, trace: Trace | None) -> None:
        """Ask for the next test, once this one's trace is recorded."""
        step = self.place.step()
        if trace is None or step is None:
            return
        if (found := digest(what_counts(trace, self.seconds))) is not None:
            self._seen.add(found)
        self._before = step.params
        self.place.close()

    def interrupt(self, urgent: bool) -> None:
        """Do nothing: no test runs while this process waits for anything but the person."""

    def end(self) -> None:
        """Let another run use the folder."""
        self.place.release()

    def _asked(self, step: Step) -> bool:
        """Ask once; return whether the test has an outcome now."""
        again = ", once more" if step.params == self._before else ""
        answer = self.operator.choose(
            f"\nTest {step.id}{again}: {self._test(step)}\nRecord {channel_words(self.needs.channels)}. "
            f"Put the log into {self.place.root / INCOMING}, then press Enter.",
            {
                "": "the log is there",
                "p": "the log is elsewhere: type its path",
                "f": "the robot fell or broke during the test: this counts",
                "s": "the robot broke before the test began: skip it for now, nothing is recorded",
                "n": "the test ran, but there is no log of it: it is void, and this is counted",
            },
        )
        if answer == "s":
            return self._skip(step)
        if answer == "n":
            self._accept(replace(step, state="accepted", void=NO_LOG))
            return True
        if answer == "f":
            return self._fell(step)
        path = self._waiting() if answer == "" else self._typed()
        return path is not None and self._try(path, step, None)

    def _fell(self, step: Step) -> bool:
        """Record a fall, with its log if there is one; return whether it is."""
        if self.place.waiting():
            path = self._waiting()
            if path is None:
                return False
            answer = self.operator.choose(
                f"Is {path} the log of this fall?", {"y": "yes", "n": "no: record the fall without a log"}
            )
            if answer == "y":
                return self._try(path, step, FALL)
        self._accept(replace(step, state="accepted", failure=FALL))
        self.operator.say(f"Accepted as {step.id}: it fell.")
        return True

    def _skip(self, step: Step) -> bool:
        """Wait until the robot works again, or the run is stopped; the same test is asked then."""
        self.place.skip(step)
        self.operator.choose(
            "Nothing was recorded. The same test is asked again, now or when the run goes on with --resume.",
            {"": "the robot works again"},
        )
        return False

    def _spoilt(self, step: Step) -> bool:
        """Return whether the log of a step that was accepted before is no longer what it was, after saying so."""
        if step.state != "accepted":
            return False
        found = self._checked(self.place.root / ORIGINALS / str(step.log), step, step.failure)
        if found.why is not None:
            self.operator.say(f"The log of {self._test(step)} cannot be used any more: {found.why}.")
        return found.why is not None

    def _waiting(self) -> Path | None:
        """Return the one log in ``incoming``; say so if there is none or several."""
        found, where = self.place.waiting(), self.place.root / INCOMING
        if len(found) == 1:
            return found[0]
        if not found:
            self.operator.say(f"There is no log in {where}: put one there that ends in {', '.join(FORMATS)}.")
        else:
            names = ", ".join(path.name for path in found[:5])
            self.operator.say(f"There are several logs in {where} ({names}): leave only that of this test.")
        return None

    def _typed(self) -> Path | None:
        """Return the path that is typed, if it can be a log."""
        path = Path(self.operator.line("Path of the log: ")).expanduser()
        if path.suffix.lower() in FORMATS and path.is_file():
            return path
        self.operator.say(f"There is no log {path}: it must be a file that ends in {', '.join(FORMATS)}.")
        return None

    def _try(self, path: Path, step: Step, failure: str | None) -> bool:
        """Accept a log if it is of the test, else say why it is not; return whether it was accepted."""
        try:
            found = self._checked(path, step, failure)
            if found.trace is not None:
                kept = path if path.parent == self.place.root / ORIGINALS else self.place.take(path, step)
                self._accept(replace(step, state="accepted", log=kept.name, failure=failure))
                self._said(step, found.trace, found.notes)
                return True
            where = self.place.refuse(path)
        except UsageError as error:
            self.operator.say(str(error))
            return False
        moved = f" It is in {self.place.root / REFUSED} now." if where != path else ""
        self.operator.say(f"{path.name} is refused: {found.why}.{moved}")
        self.operator.say("A test that ran counts: give its right log, or answer f or n.")
        return False

    def _checked(self, path: Path, step: Step, failure: str | None) -> _Found:
        """Read a log, and look whether it is of the test."""
        try:
            read = self.reading.load(path)
        except TraceError as error:
            return _Found(None, str(error).removeprefix(f"{path}: "))
        trace = self.reading.held(read.trace)
        if failure is not None:
            trace = Trace(trace.times, trace.channels, trace.units, dict(trace.meta) | {"failure": failure})
        why = refusal(trace, Question(step.params, self.needs, self.seconds))
        if why is not None:
            lacking = next((c.name for c in self.needs.channels if c.name in read.left_out), None)
            return _Found(None, why if lacking is None else read.left_out[lacking])
        # A recorder that was not stopped between two tests begins its next log with the last one.
        if digest(what_counts(alike(trace, self.needs.channels), self.seconds)) in self._seen:
            return _Found(None, "it is the log of an earlier test, sample for sample")
        units = {c.name: c.unit for c in self.needs.channels}
        unsaid = [
            f"the channel {name} has no unit; its numbers are read as {units[name]}"
            for name in without_unit(trace, self.needs.channels)
        ]
        return _Found(trace, None, (*read.notes, *unsaid))

    def _said(self, step: Step, trace: Trace, notes: tuple[str, ...]) -> None:
        """Say that a log was accepted, and each note once."""
        ended = f", {trace.failure}" if trace.failure is not None else ""
        self.operator.say(f"Accepted as {step.id}: {trace.duration:.4g} s, {len(trace)} samples{ended}.")
        for note in notes:
            if note not in self._noted:
                self.operator.say(f"Note: {note}.")
                self._noted.add(note)

    def _leave(self, step: Step) -> None:
        """Say what becomes of an outcome that no run asks for any more."""
        if step.state == "accepted" and step.log is not None:
            self.operator.say(
                f"Another run had asked for {self._test(step)}; its log is kept as "
                f"{self.place.root / ORIGINALS / step.log}, and is no rollout of this run."
            )
        self.place.close()

    def _accept(self, step: Step) -> None:
        self.place.write(step, self._about())

    def _about(self) -> dict[str, object]:
        """Return what a script of the lab may want to know of the test."""
        return {
            "units": {p.name: p.unit for p in self.needs.parameters},
            "channels": {c.name: c.unit for c in self.needs.channels},
            "seconds": self.seconds,
        }

    def _test(self, step: Step) -> str:
        return test_words(step.params, self.needs.parameters)
