"""The operator of a machine and the policy for its void rollouts, fixed before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from s2r_spec.backend import Attended, Backend, Coming, HasAttendance, Operator, is_exclusive
from s2r_spec.backend.protocols import Protocol
from s2r_spec.base.errors import UsageError
from s2r_spec.machine.operator import Terminal, require_terminal
from s2r_spec.runs.machine_journal import AGAIN, FALL
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Terms:
    """Operator and void policy of a machine; a simulator ignores both.

    The policy, ``AGAIN`` or ``FALL``, is declared before the data.
    """

    void: str = AGAIN
    operator: Operator = field(default_factory=Terminal)

    def __post_init__(self) -> None:
        if self.void not in (AGAIN, FALL):
            raise UsageError(f"void must be {AGAIN} or {FALL}, not {self.void!r}")


def refuse_terms(backend: Backend, terms: Terms) -> None:
    """Refuse terms that do not fit a backend, before anything is opened, with a UsageError."""
    if is_exclusive(backend):
        attendance_of(backend, terms.operator)
    elif terms.void != AGAIN:
        raise UsageError(
            f"--void {terms.void} applies only to machines, and {backend.name} is not one: leave --void out"
        )


def attendance_of(backend: Backend, operator: Operator) -> Attended:
    """Return the attendance of a machine's rollouts; a UsageError says that it needs a terminal, and there is none."""
    attended = (
        backend.attendance(operator) if isinstance(backend, HasAttendance) else _Plain(backend.name, operator)
    )
    if not getattr(attended, "unattended", False):
        require_terminal(operator)
    return attended


@dataclass(frozen=True)
class _Plain:
    """Attendance of a machine without its own: the operator confirms every rollout."""

    name: str
    operator: Operator

    def begin(self, coming: Coming) -> None:
        many = "an unknown number of" if coming.rollouts is None else f"at most {coming.rollouts}"
        self.operator.say(f"{self.name} is a machine; {many} rollouts are coming, one at a time.")

    def before(self, params: Mapping[str, float]) -> None:
        self.operator.choose(f"The next test of {self.name} is {_words(params)}.", {"": "begin"})

    def before_protocol(self, protocol: Protocol, params: Mapping[str, float]) -> None:
        values = f" with {_words(params)}" if params else ""
        risk = f" Risk: {protocol.risk}." if protocol.risk else ""
        question = f"The next protocol of {self.name} is {protocol.name}{values}. {protocol.words}{risk}"
        self.operator.choose(question, {"": "begin"})

    def after(self, trace: Trace | None) -> None: ...

    def interrupt(self, urgent: bool) -> None: ...  # the rollout runs to its end

    def end(self) -> None: ...


def _words(params: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in params.items())
