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

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from s2r_spec.runs import lines
from s2r_spec.runs.lines import JournalError, is_count, is_length, is_point, is_text

Key = tuple[int, int]
"""Query and replicate of a rollout."""

BEGUN, VOID, NOT_BEGUN = "begun", "void", "not begun"
AGAIN, FALL = "again", "fall"
"""Definition: the policy for void rollouts. Either the test runs again, or the void rollout counts as a fall."""
KILLED = "killed"
"""Definition: the word for a rollout whose process died, was killed, or exceeded its time limit."""
LONGEST_REASON = 1000
"""Budget: characters of a reason that a line keeps."""


@dataclass(frozen=True)
class Attempt:
    """One attempt at a rollout on a machine, counted from 1; ``answers`` has question → the operator's answer."""

    query: int
    replicate: int
    attempt: int
    params: dict[str, float]
    seed: int
    answers: dict[str, str] = field(default_factory=dict)

    @property
    def key(self) -> Key:
        """Query and replicate of the rollout."""
        return self.query, self.replicate


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


def _is_void_trace(value: Any) -> bool:
    form = r"void/[0-9]{5,}\.[0-9]{4,}\.[0-9]+\.npz"
    return value is None or (isinstance(value, str) and bool(re.fullmatch(form, value)))


_IDENTITY: Mapping[str, tuple[lines.Test, str]] = {
    "kind": (is_text, "a text"),
    "query": (is_count, "a whole number"),
    "replicate": (is_count, "a whole number"),
    "attempt": (lambda value: is_count(value) and value > 0, "a whole number above 0"),
}
_TEST: Mapping[str, tuple[lines.Test, str]] = {
    "params": (is_point, "an object with a number for each parameter"),
    "seed": (is_count, "a whole number"),
}
ANSWERS = "answers"
"""Field with the operator's answers before a rollout; absent if the operator was not asked."""


def _are_answers(value: Any) -> bool:
    return isinstance(value, dict) and all(map(is_text, value.values()))


_REASON: Mapping[str, tuple[lines.Test, str]] = {"reason": (is_text, "a text")}
_OUTCOME: Mapping[str, tuple[lines.Test, str]] = {
    "word": (is_text, "a text"),
    "trace": (_is_void_trace, "the name of a file in void/, or null"),
    "seconds": (is_length, "a number that is not negative"),
}
_FIELDS = {
    BEGUN: {**_IDENTITY, **_TEST},
    VOID: {**_IDENTITY, **_TEST, **_REASON, **_OUTCOME},
    NOT_BEGUN: {**_IDENTITY, **_REASON},
}


def trace_file(attempt: Attempt) -> str:
    """Return the file for the trace of a void attempt, relative to the run's folder."""
    return f"void/{attempt.query:05d}.{attempt.replicate:04d}.{attempt.attempt}.npz"


def begun_line(attempt: Attempt) -> dict[str, Any]:
    """Return the journal's line for an attempt that is about to begin."""
    return {
        "kind": BEGUN,
        **_identity(attempt),
        **({ANSWERS: attempt.answers} if attempt.answers else {}),
    }


def void_line(void: Void) -> dict[str, Any]:
    """Return the journal's line for a void rollout."""
    outcome = {"word": void.word, "reason": void.reason, "trace": void.trace, "seconds": void.seconds}
    return {"kind": VOID, **_identity(void.rollout), **outcome}


def not_begun_line(attempt: Attempt, reason: str) -> dict[str, Any]:
    """Return the journal's line for a rollout that never began."""
    identity = {name: value for name, value in _identity(attempt).items() if name in _IDENTITY}
    return {"kind": NOT_BEGUN, **identity, "reason": reason[:LONGEST_REASON]}


def _identity(attempt: Attempt) -> dict[str, Any]:
    """Return the fields that identify an attempt: all but the answers."""
    return {name: value for name, value in vars(attempt).items() if name != ANSWERS}


@dataclass
class Attempts:
    """The attempts that a journal records.

    Attributes:
        counts: number of attempts per rollout.
        open: attempts that began and that no line ends.
        voids: void rollouts in the order of the journal, each with the checksum of its trace file.
    """

    counts: dict[Key, int] = field(default_factory=dict)
    open: dict[Key, Attempt] = field(default_factory=dict)
    voids: list[tuple[Void, str | None]] = field(default_factory=list)

    def next(self, key: Key, params: Mapping[str, float], seed: int, answers: Mapping[str, str]) -> Attempt:
        """Return the next attempt at a rollout."""
        return Attempt(*key, self.counts.get(key, 0) + 1, dict(params), seed, dict(answers))

    def begin(self, attempt: Attempt) -> None:
        """Add an attempt that is about to begin."""
        self.counts[attempt.key] = attempt.attempt
        self.open[attempt.key] = attempt

    def end(self, key: Key) -> None:
        """Close the attempt at a rollout that has an outcome, or that did not begin."""
        self.open.pop(key, None)

    def void(self, void: Void, trace_sum: str | None) -> None:
        """Close the attempt at a rollout that was void."""
        self.end(void.rollout.key)
        self.voids.append((void, trace_sum))

    def read(self, path: Path, number: int, line: Mapping[str, Any]) -> None:
        """Add a line with a field ``kind``.

        Raises:
            JournalError: the kind is unknown, a field is missing or wrong, or the line ends an attempt that the
                journal does not announce.
        """
        values = {name: value for name, value in line.items() if name not in ("crc32", lines.TRACE_SUM)}
        kind = values.get("kind")
        fields = _FIELDS.get(kind) if isinstance(kind, str) else None
        if fields is None:
            wrong = f"kind must be {BEGUN}, {VOID} or {NOT_BEGUN}, not {lines.excerpt(kind)}"
        else:
            if kind == BEGUN and ANSWERS in values:
                fields = {**fields, ANSWERS: (_are_answers, "an object with a text for each question")}
            wrong = lines.fault(values, fields)
            if not wrong and (unknown := sorted(values.keys() - fields.keys())):
                wrong = f"{unknown[0]!r} is an unknown field"
            if not wrong and not lines.is_text_or_none(line.get(lines.TRACE_SUM)):
                wrong = f"{lines.TRACE_SUM} must be a string"
        key = (values.get("query"), values.get("replicate"))
        if not wrong and kind != BEGUN:
            attempt = self.open.get(key)  # type: ignore[arg-type]
            if attempt is None or attempt.attempt != values["attempt"]:
                wrong = "it ends an attempt that no earlier line began"
        if wrong:
            raise JournalError(
                f"{path}:{number}: not a line of a machine's journal: {wrong}; restore the journal from a copy, or "
                f"begin a new run"
            )
        if kind == BEGUN:
            self.begin(Attempt(**{name: value for name, value in values.items() if name != "kind"}))
        elif kind == VOID:
            attempt = replace(
                self.open[values["query"], values["replicate"]], params=values["params"], seed=values["seed"]
            )
            outcome = {name: values[name] for name in ("word", "reason", "trace", "seconds")}
            self.void(Void(attempt, **outcome), line.get(lines.TRACE_SUM))
        else:
            self.end((values["query"], values["replicate"]))
