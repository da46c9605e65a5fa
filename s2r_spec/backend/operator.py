"""The person at a machine, and the part of its backend that runs in the process with the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from s2r_spec.trace import Trace


class Operator(Protocol):
    """The person at the terminal. Without a terminal every question raises a UsageError at once."""

    def say(self, text: str) -> None:
        """Show a text; without a terminal, on standard error."""

    def type_word(self, question: str, word: str) -> None:
        """Ask until the person types exactly this word.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """

    def choose(self, question: str, answers: Mapping[str, str]) -> str:
        """Return the key that the person types, one of key → meaning; the key "" is Enter alone.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """

    def line(self, question: str) -> str:
        """Return the line that the person types, such as the path of a file.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """


@dataclass(frozen=True)
class Coming:
    """The rollouts that a run plans on a machine.

    Attributes:
        rollouts: largest number of rollouts; None if unknown.
    """

    rollouts: int | None


class Attended(Protocol):
    """The part of a machine's backend that runs in the process with the terminal; a worker has no terminal.

    With an attribute ``unattended = True`` no question is asked. Without it, a run without a terminal is refused before
    anything is opened, and the operator decides after a void rollout whether the same test runs again.

    An optional attribute ``answers``, name → text, holds the operator's answers in the last ``before``, such as the
    lights of the battery. The journal and the trace's ``meta["answers"]`` keep them.
    """

    def begin(self, coming: Coming) -> None:
        """Prepare the machine and ask for the operator's consent, before the first rollout."""

    def before(self, params: Mapping[str, float]) -> None:
        """Return when the rollout of this test may begin.

        Raises:
            NotBegunError: the rollout may not begin; the operator decides whether to try again.
            StoppedError: the operator ends the run.
        """

    def after(self, trace: Trace | None) -> None:
        """Finish a rollout, whose trace is recorded; None if it left no trace or did not begin."""

    def interrupt(self, urgent: bool) -> None:
        """Bring the machine to rest during a rollout; at once if ``urgent``, after a second Ctrl-C. Returns soon."""

    def end(self) -> None:
        """Leave the machine at rest after the last rollout, or after any other end of the run."""


@runtime_checkable
class HasAttendance(Protocol):
    """A machine whose rollouts need a person or a guard in the process with the terminal."""

    def attendance(self, operator: Operator) -> Attended:
        """Return the attendance of a run's rollouts; open nothing."""
