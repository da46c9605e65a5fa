"""The dialogue with the person who runs the tests, in the process with the terminal.

It requests a test until there is a valid log, or a word for how the test ended. A test that did not begin is no
rollout, and is requested again. A test that began counts, however it ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from s2r_spec.backend import Coming, Needs, Operator
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.logs import READABLE
from s2r_spec.machine.manual import checks
from s2r_spec.machine.manual.folder import INCOMING, ORIGINALS, REFUSED, PendingTest, TestFolder
from s2r_spec.machine.manual.words import channel_words, test_words
from s2r_spec.recordings.log_folder import digest
from s2r_spec.recordings.log_options import LogOptions
from s2r_spec.trace import Trace

FALL = "fall"
"""Definition: the failure word of a rollout that the robot ended."""
NO_LOG = "log"
"""Definition: the void word of a rollout that ran and left no log."""


@dataclass(frozen=True)
class _Checked:
    trace: Trace | None
    refusal: str | None
    notes: tuple[str, ...] = ()


@dataclass
class Attendance:
    """Requests tests from a person; see :class:`s2r_spec.backend.Attended`.

    ``seconds`` is the horizon of the specification [s]; 0 if it reads a trace to its end.
    """

    tests: TestFolder
    options: LogOptions
    needs: Needs
    seconds: float
    operator: Operator
    _digests: set[bytes] = field(default_factory=set)
    _noted: set[str] = field(default_factory=set)
    _previous: dict[str, float] | None = None

    def begin(self, coming: Coming) -> None:
        """Prepare the folder, and announce the tests; a UsageError says why the folder cannot be used for them."""
        self._digests = set(self.tests.prepare(self.needs.channels, self.needs.parameters, self.seconds))
        count, recorded = coming.rollouts, self.tests.recorded()
        tests = "Tests are coming" if count is None else f"At most {count} tests are coming"
        holds = f" {self.tests.root} already holds {recorded} recorded tests." if recorded else ""
        self.operator.say(
            f"{tests}, one after the other. You run each on the robot, and put its log into "
            f"{self.tests.root / INCOMING}.{holds}"
        )
        if self.seconds > 0:
            self.operator.say(f"Each test takes {self.seconds:g} s from the first sample of its log.")

    def before(self, params: Mapping[str, float]) -> None:
        """Request a test until it has an outcome; after a StoppedError, --resume requests the same test again."""
        test = self.tests.pending()
        if test is not None and test.params != dict(params):
            self._abandon(test)
            test = None
        if test is not None and test.log is not None and self._is_spoilt(test):
            test = None
        if test is not None and test.state != "asked":
            self.operator.say(f"{self._words(test)} already has an outcome: {test.id}.")
            return
        test = test or self.tests.new(params)
        self._write(test)
        if (log := self.tests.taken(test)) is not None and self._try(log, test, None):
            return
        while not self._request(test):
            pass

    def after(self, trace: Trace | None) -> None:
        """Close the test after its trace is recorded."""
        test = self.tests.pending()
        if trace is None or test is None:
            return
        if (key := digest(checks.within_horizon(trace, self.seconds))) is not None:
            self._digests.add(key)
        self._previous = test.params
        self.tests.close()

    def interrupt(self, urgent: bool) -> None:
        """Do nothing: s2r waits for the person while a test runs."""

    def end(self) -> None:
        """Release the folder for another run."""
        self.tests.release()

    def _request(self, test: PendingTest) -> bool:
        again = ", once more" if test.params == self._previous else ""
        answer = self.operator.choose(
            f"\nTest {test.id}{again}: {self._words(test)}\nRecord {channel_words(self.needs.channels)}. "
            f"Put the log into {self.tests.root / INCOMING}, then press Enter.",
            {
                "": "the log is there",
                "p": "the log is elsewhere: type its path",
                "f": "the robot fell or broke during the test: this counts",
                "s": "the robot broke before the test began: skip it for now, nothing is recorded",
                "n": "the test ran but left no log: it is void, and counted as void",
            },
        )
        if answer == "s":
            # Wait until the robot works again; then the same test is requested again.
            self.tests.skip(test)
            self.operator.choose(
                "s2r recorded nothing. It requests the same test again, now or when you resume the run with --resume.",
                {"": "the robot works again"},
            )
            return False
        if answer == "n":
            self._write(replace(test, state="accepted", void=NO_LOG))
            return True
        if answer == "f":
            return self._fell(test)
        path = self._waiting() if answer == "" else self._typed()
        return path is not None and self._try(path, test, None)

    def _fell(self, test: PendingTest) -> bool:
        """Record a fall, with its log if there is one; return whether it was recorded."""
        if self.tests.waiting():
            path = self._waiting()
            if path is None:
                return False
            answer = self.operator.choose(
                f"Is {path} the log of this fall?", {"y": "yes", "n": "no: record the fall without a log"}
            )
            if answer == "y":
                return self._try(path, test, FALL)
        self._write(replace(test, state="accepted", failure=FALL))
        self.operator.say(f"Accepted as {test.id}: the robot fell.")
        return True

    def _is_spoilt(self, test: PendingTest) -> bool:
        """Return whether the accepted log of a test is no longer valid, and tell the person."""
        if test.state != "accepted":
            return False
        checked = self._check(self.tests.root / ORIGINALS / str(test.log), test, test.failure)
        if checked.refusal is not None:
            self.operator.say(f"The log of {self._words(test)} is no longer valid: {checked.refusal}.")
        return checked.refusal is not None

    def _waiting(self) -> Path | None:
        logs, where = self.tests.waiting(), self.tests.root / INCOMING
        if len(logs) == 1:
            return logs[0]
        names = ", ".join(path.name for path in logs[:5])
        several = f"There are several logs in {where} ({names}): leave only the log of this test."
        none = f"There is no log in {where}: put one there that ends in {', '.join(READABLE)}."
        self.operator.say(several if logs else none)
        return None

    def _typed(self) -> Path | None:
        path = Path(self.operator.line("Path of the log: ")).expanduser()
        if path.suffix.lower() in READABLE and path.is_file():
            return path
        self.operator.say(f"There is no log {path}: it must be a file that ends in {', '.join(READABLE)}.")
        return None

    def _try(self, path: Path, test: PendingTest, failure: str | None) -> bool:
        """Accept a log of the test, or tell the person why it is refused; return whether it was accepted."""
        try:
            checked = self._check(path, test, failure)
            if checked.trace is not None:
                kept = path if path.parent == self.tests.root / ORIGINALS else self.tests.take(path, test)
                self._write(replace(test, state="accepted", log=kept.name, failure=failure))
                self._report(test, checked.trace, checked.notes)
                return True
            where = self.tests.refuse(path)
        except UsageError as error:
            self.operator.say(str(error))
            return False
        moved = f" It is in {self.tests.root / REFUSED} now." if where != path else ""
        self.operator.say(f"{path.name} is refused: {checked.refusal}.{moved}")
        self.operator.say("A test that ran counts: give the right log, or answer f or n.")
        return False

    def _check(self, path: Path, test: PendingTest, failure: str | None) -> _Checked:
        try:
            loaded = self.options.load(path)
        except TraceError as error:
            return _Checked(None, str(error).removeprefix(f"{path}: "))
        trace = self.options.fill_gaps(loaded.trace)
        if failure is not None:
            trace = replace(trace, meta=dict(trace.meta) | {"failure": failure})
        reason = checks.refusal(trace, checks.RequestedTest(test.params, self.needs, self.seconds))
        if reason is not None:
            lacking = next((c.name for c in self.needs.channels if c.name in loaded.left_out), None)
            return _Checked(None, reason if lacking is None else loaded.left_out[lacking])
        # A recorder that runs on between two tests begins its next log with the previous test.
        key = digest(checks.within_horizon(checks.in_common_form(trace, self.needs.channels), self.seconds))
        if key in self._digests:
            return _Checked(None, "it is the log of an earlier test, sample for sample")
        units = {c.name: c.unit for c in self.needs.channels}
        assumed = [
            f"the channel {name} has no unit; s2r reads its numbers in {units[name]}"
            for name in checks.without_unit(trace, self.needs.channels)
        ]
        return _Checked(trace, None, (*loaded.notes, *assumed))

    def _report(self, test: PendingTest, trace: Trace, notes: tuple[str, ...]) -> None:
        ended = f", {trace.failure}" if trace.failure is not None else ""
        self.operator.say(f"Accepted as {test.id}: {trace.duration:.4g} s, {len(trace)} samples{ended}.")
        for note in notes:
            if note not in self._noted:
                self.operator.say(f"Note: {note}.")
                self._noted.add(note)

    def _abandon(self, test: PendingTest) -> None:
        """Close a test that another run requested, and tell the person where its log is."""
        if test.state == "accepted" and test.log is not None:
            self.operator.say(
                f"Another run requested {self._words(test)}; its log stays in "
                f"{self.tests.root / ORIGINALS / test.log}, and is not a rollout of this run."
            )
        self.tests.close()

    def _write(self, test: PendingTest) -> None:
        """Write the pending test, with facts for the lab's scripts."""
        units = {p.name: p.unit for p in self.needs.parameters}
        channels = {c.name: c.unit for c in self.needs.channels}
        self.tests.write(test, {"units": units, "channels": channels, "seconds": self.seconds})

    def _words(self, test: PendingTest) -> str:
        return test_words(test.params, self.needs.parameters)
