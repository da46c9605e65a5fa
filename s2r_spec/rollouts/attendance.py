"""Who attends to a machine, and on what terms: settled before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from s2r_spec.backend import Attended, Backend, Coming, HasAttendance, Operator, is_exclusive
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.attempts import AGAIN, FALL
from s2r_spec.rollouts.operator import Terminal, refuse_nobody
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Terms:
    """How the rollouts of a machine are attended to; those of a simulator need none of it.

    Attributes:
        void: what becomes of a void rollout, ``AGAIN`` or ``FALL``; declared before the data.
        operator: the person that is asked.
    """

    void: str = AGAIN
    operator: Operator = field(default_factory=Terminal)

    def __post_init__(self) -> None:
        if self.void not in (AGAIN, FALL):
            raise UsageError(f"void is {AGAIN} or {FALL}, not {self.void!r}")


def terms_of(void: Any, operator: Operator | None) -> Terms:
    """Return terms as a caller gave them; the operator is the person at this process's terminal if None is given."""
    return Terms(void) if operator is None else Terms(void, operator)


def refuse_terms(backend: Backend, terms: Terms) -> None:
    """Refuse terms that do not fit a backend, before anything is opened.

    Raises:
        UsageError: it is a machine whose operator is at no terminal, or no machine, of which nothing can be void.
    """
    if is_exclusive(backend):
        attendance_of(backend, terms.operator)
    elif terms.void != AGAIN:
        raise UsageError(f"void rollouts are a machine's, and {backend.name} is none: leave --void out")


def attendance_of(backend: Backend, operator: Operator) -> Attended:
    """Return who attends to a machine.

    Raises:
        UsageError: a person must, and is at no terminal.
    """
    attended = (
        backend.attendance(operator) if isinstance(backend, HasAttendance) else _Plain(backend.name, operator)
    )
    if not getattr(attended, "unattended", False):
        refuse_nobody(operator)
    return attended


@dataclass(frozen=True)
class _Plain:
    """Attends to a machine that says nothing of how: its operator lets every rollout begin."""

    name: str
    operator: Operator

    def begin(self, coming: Coming) -> None:
        """Say what is coming."""
        many = "an unknown number of" if coming.rollouts is None else f"at most {coming.rollouts}"
        self.operator.say(f"{self.name} is a machine; {many} rollouts are coming, one at a time.")

    def before(self, params: Mapping[str, float]) -> None:
        """Wait for Enter."""
        test = ", ".join(f"{name} = {value:.6g}" for name, value in params.items())
        self.operator.choose(f"The next test of {self.name} is {test}.", {"": "begin"})

    def after(self, trace: Trace | None) -> None:
        """Do nothing."""

    def interrupt(self, urgent: bool) -> None:
        """Do nothing: the rollout runs to its end."""

    def end(self) -> None:
        """Do nothing."""
