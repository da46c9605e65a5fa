"""Further lines of a machine's journal, beyond its rollouts: attempts that began, and attempts without an outcome.

A machine's rollout cannot be undone, so the journal announces each one before it begins. One of these ends it:

    {"kind": "begun", …}        s2r is about to start this rollout on the machine; holds the operator's answers, if any
    a rollout's line            the rollout has an outcome, as in every journal
    {"kind": "void", …}         something other than the robot ended it: the trace is kept, and the same test runs again
    {"kind": "not begun", …}    nothing moved before t = 0: there is no rollout
    (nothing)                   s2r was killed; `--resume` adds a line "void" with the word "killed"

The attempts at one rollout (query and replicate) are counted from 1. Journals of simulators have none of these lines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from s2r_spec.runs import lines
from s2r_spec.runs.lines import is_count, is_text

BEGUN, VOID, NOT_BEGUN = "begun", "void", "not begun"
AGAIN, FALL = "again", "fall"
"""Definition: the policy for void rollouts. Either the test runs again, or the void rollout counts as a fall."""
KILLED = "killed"
"""Definition: the word for a rollout whose process died, was killed, or exceeded its time limit."""
LONGEST_REASON = 1000
"""Budget: characters of a reason that a line keeps."""


ANSWERS = "answers"
"""Field with the operator's answers before a rollout; absent if the operator was not asked."""


@dataclass(frozen=True)
class Attempt(lines.Rollout):
    """One attempt at a rollout on a machine, counted from 1; ``answers`` has question → the operator's answer."""

    attempt: int
    params: dict[str, float]
    seed: int
    answers: dict[str, str] = field(default_factory=dict)

    @property
    def trace_file(self) -> str:
        """File for the trace if the attempt is void, relative to the run's folder."""
        return f"void/{self.query:05d}.{self.replicate:04d}.{self.attempt}.npz"

    def begun_line(self) -> dict[str, Any]:
        """Return the journal's line before the attempt begins."""
        return {"kind": BEGUN} | {
            name: value for name, value in vars(self).items() if name != ANSWERS or value
        }

    def not_begun_line(self, reason: str) -> dict[str, Any]:
        """Return the journal's line if the rollout never began."""
        number = {"query": self.query, "replicate": self.replicate, "attempt": self.attempt}
        return {"kind": NOT_BEGUN, **number, "reason": reason[:LONGEST_REASON]}


@dataclass(frozen=True)
class Void:
    """A rollout that something other than the robot ended: its cause as a word ("link", …) and as a sentence.

    ``trace`` is the file relative to the run's folder; ``seconds`` is the duration [s].
    """

    rollout: Attempt
    word: str
    reason: str
    trace: str | None
    seconds: float

    def line(self) -> dict[str, Any]:
        """Return the journal's line."""
        own = {name: value for name, value in vars(self).items() if name != "rollout"}
        return replace(self.rollout, answers={}).begun_line() | {"kind": VOID} | own


_IDENTITY: Mapping[str, tuple[lines.Test, str]] = {
    "kind": lines.TEXT,
    "query": lines.COUNT,
    "replicate": lines.COUNT,
    "attempt": (lambda value: is_count(value) and value > 0, "a whole number above 0"),
}
_OUTCOME: Mapping[str, tuple[lines.Test, str]] = {
    "word": lines.TEXT,
    "trace": (
        lines.is_file(r"void/[0-9]{5,}\.[0-9]{4,}\.[0-9]+\.npz"),
        "the name of a file in void/, or null",
    ),
    "seconds": lines.SECONDS,
}
_FIELDS = {
    BEGUN: {**_IDENTITY, **lines.TEST},
    VOID: {**_IDENTITY, **lines.TEST, "reason": lines.TEXT, **_OUTCOME},
    NOT_BEGUN: {**_IDENTITY, "reason": lines.TEXT},
}


def _are_answers(value: Any) -> bool:
    return isinstance(value, dict) and all(map(is_text, value.values()))


@dataclass
class Attempts:
    """The attempts that a journal records: their number per rollout, those that no line ends, and the void ones.

    The void ones are in the order of the journal, each with the checksum of its trace file.
    """

    counts: dict[lines.Key, int] = field(default_factory=dict)
    open: dict[lines.Key, Attempt] = field(default_factory=dict)
    voids: list[tuple[Void, str | None]] = field(default_factory=list)

    def begin(self, attempt: Attempt) -> None:
        """Add an attempt that is about to begin."""
        self.counts[attempt.key] = attempt.attempt
        self.open[attempt.key] = attempt

    def end(self, key: lines.Key) -> None:
        """Close the attempt at a rollout that has an outcome, or that did not begin."""
        self.open.pop(key, None)

    def void(self, void: Void, trace_sum: str | None) -> None:
        """Close the attempt at a rollout that was void."""
        self.end(void.rollout.key)
        self.voids.append((void, trace_sum))

    def read(self, path: Path, number: int, line: Mapping[str, Any]) -> None:
        """Add a line with a field ``kind``; raise a JournalError if it is damaged, or ends no attempt that began."""
        what, kind = "not a line of a machine's journal: ", line.get("kind")
        fields = _FIELDS.get(kind) if isinstance(kind, str) else None
        if fields is None:
            wrong = f"kind must be {BEGUN}, {VOID} or {NOT_BEGUN}, not {lines.excerpt(kind)}"
            raise lines.damage(path, number, what + wrong)
        if kind == BEGUN and ANSWERS in line:
            fields = {**fields, ANSWERS: (_are_answers, "an object with a text for each question")}
        values = lines.read_fields(path, number, line, fields, what)
        del values["kind"]
        if kind == BEGUN:
            self.begin(Attempt(**values))
            return
        attempt = self.open.get((values["query"], values["replicate"]))
        if attempt is None or attempt.attempt != values["attempt"]:
            raise lines.damage(path, number, f"{what}it ends an attempt that no earlier line began")
        if kind == NOT_BEGUN:
            self.end(attempt.key)
            return
        attempt = replace(attempt, params=values["params"], seed=values["seed"])
        outcome = {name: values[name] for name in ("word", "reason", "trace", "seconds")}
        self.void(Void(attempt, **outcome), line.get(lines.TRACE_SUM))
