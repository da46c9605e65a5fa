"""Lines of a machine's journal besides its rollouts: what was begun, and what of it came to nothing.

A rollout of a machine cannot be taken back, so each is announced before it begins. One of four things ends it:

    {"kind": "begun", …}        s2r is about to hand this rollout to the machine; with its operator's answers, if any
    a rollout's line            an outcome, as every journal has it
    {"kind": "void", …}         something else than the robot ended it: kept, no outcome, the same test runs again
    {"kind": "not begun", …}    nothing moved before t = 0: no rollout
    (nothing)                   s2r was killed meanwhile: whoever resumes the run adds the line "void", word "killed"

The attempts of one key are counted from 1. Journals of simulators have none of these lines.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from s2r_spec.rollouts import lines
from s2r_spec.rollouts.lines import JournalError, is_count, is_length, is_point, is_text

Key = tuple[int, int]
"""Query and replicate of a rollout."""

BEGUN, VOID, NOT_BEGUN = "begun", "void", "not begun"
AGAIN, FALL = "again", "fall"
"""Definition: what becomes of a void rollout. Its test runs again, or it counts as a fall."""
KILLED = "killed"
"""Word of a rollout whose process died, was killed, or was ended because it took too long."""
LONGEST_REASON = 1000
"""Budget: letters of a reason that a line keeps. Twice as many make the line twice as long."""


@dataclass(frozen=True)
class Begun:
    """A rollout that was handed to the machine.

    Attributes:
        attempt: counts those of its key from 1.
        answers: of the operator before it, by what was asked.
    """

    query: int
    replicate: int
    attempt: int
    params: dict[str, float]
    seed: int
    answers: dict[str, str] = field(default_factory=dict)

    @property
    def key(self) -> Key:
        """Of the rollout."""
        return self.query, self.replicate


@dataclass(frozen=True)
class Void:
    """A rollout that something else than the robot ended.

    Attributes:
        begun: which it was.
        word: what ended it: "link", "operator", "killed", …
        reason: the same in a sentence.
        trace: file of what was recorded of it, in the run's folder; None if nothing was.
        seconds: that it took [s].
    """

    begun: Begun
    word: str
    reason: str
    trace: str | None
    seconds: float


def _is_void_trace(value: Any) -> bool:
    form = r"void/[0-9]{5,}\.[0-9]{4,}\.[0-9]+\.npz"
    return value is None or (isinstance(value, str) and bool(re.fullmatch(form, value)))


_WHICH: Mapping[str, tuple[lines.Test, str]] = {
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
"""Field of a line that says what the operator answered before a rollout; not there where nothing was asked."""


def _are_answers(value: Any) -> bool:
    return isinstance(value, dict) and all(map(is_text, value.values()))


_WHY: Mapping[str, tuple[lines.Test, str]] = {"reason": (is_text, "a text")}
_ENDED: Mapping[str, tuple[lines.Test, str]] = {
    "word": (is_text, "a text"),
    "trace": (_is_void_trace, "the name of a file in void/, or null"),
    "seconds": (is_length, "a number that is not negative"),
}
_FIELDS = {
    BEGUN: {**_WHICH, **_TEST},
    VOID: {**_WHICH, **_TEST, **_WHY, **_ENDED},
    NOT_BEGUN: {**_WHICH, **_WHY},
}


def trace_file(begun: Begun) -> str:
    """Return where the trace of a rollout lies in its run's folder if the rollout is void."""
    return f"void/{begun.query:05d}.{begun.replicate:04d}.{begun.attempt}.npz"


def begun_line(begun: Begun) -> dict[str, Any]:
    """Return what the journal has of a rollout that is about to begin."""
    return {"kind": BEGUN, **_which(begun), **({ANSWERS: begun.answers} if begun.answers else {})}


def void_line(void: Void) -> dict[str, Any]:
    """Return what the journal has of a rollout that was void."""
    ended = {"word": void.word, "reason": void.reason, "trace": void.trace, "seconds": void.seconds}
    return {"kind": VOID, **_which(void.begun), **ended}


def not_begun_line(begun: Begun, reason: str) -> dict[str, Any]:
    """Return what the journal has of a rollout that never began."""
    which = {name: value for name, value in _which(begun).items() if name in _WHICH}
    return {"kind": NOT_BEGUN, **which, "reason": reason[:LONGEST_REASON]}


def _which(begun: Begun) -> dict[str, Any]:
    """Return what says which rollout it was."""
    return {name: value for name, value in vars(begun).items() if name != ANSWERS}


@dataclass
class Attempts:
    """What a journal says of the attempts so far.

    Attributes:
        counts: how many rollouts of a key were begun.
        open: begun, and nothing has ended them.
        voids: in the order in which they were recorded, each with the checksum of its trace's file.
    """

    counts: dict[Key, int] = field(default_factory=dict)
    open: dict[Key, Begun] = field(default_factory=dict)
    voids: list[tuple[Void, str | None]] = field(default_factory=list)

    def next(self, key: Key, params: Mapping[str, float], seed: int, answers: Mapping[str, str]) -> Begun:
        """Return the next attempt at a rollout."""
        return Begun(*key, self.counts.get(key, 0) + 1, dict(params), seed, dict(answers))

    def begin(self, begun: Begun) -> None:
        """Count a rollout that is about to begin."""
        self.counts[begun.key] = begun.attempt
        self.open[begun.key] = begun

    def end(self, key: Key) -> None:
        """Count a rollout that has an outcome, or did not begin."""
        self.open.pop(key, None)

    def void(self, void: Void, trace_sum: str | None) -> None:
        """Count a rollout that was void."""
        self.end(void.begun.key)
        self.voids.append((void, trace_sum))

    def read(self, path: Path, number: int, line: Mapping[str, Any]) -> None:
        """Take in a line that has a kind.

        Raises:
            JournalError: it is of no kind that there is, a field is missing or wrong, or it ends what was not begun.
        """
        values = {name: value for name, value in line.items() if name not in ("crc32", lines.TRACE_SUM)}
        kind = values.get("kind")
        fields = _FIELDS.get(kind) if isinstance(kind, str) else None
        if fields is None:
            wrong = f"{lines.shown(kind)} is no kind of line"
        else:
            if kind == BEGUN and ANSWERS in values:
                fields = {**fields, ANSWERS: (_are_answers, "an object with a text for each question")}
            wrong = lines.fault(values, fields)
            if not wrong and (unknown := sorted(values.keys() - fields.keys())):
                wrong = f"{unknown[0]!r} is no field of it"
            if not wrong and not lines.is_text_or_none(line.get(lines.TRACE_SUM)):
                wrong = f"{lines.TRACE_SUM} must be a text"
        key = (values.get("query"), values.get("replicate"))
        if not wrong and kind != BEGUN:
            begun = self.open.get(key)  # type: ignore[arg-type]
            if begun is None or begun.attempt != values["attempt"]:
                wrong = "it ends a rollout that was not begun"
        if wrong:
            raise JournalError(
                f"{path}:{number}: not a line of a machine's journal: {wrong}; restore it from a copy, or begin a "
                f"new run"
            )
        if kind == BEGUN:
            self.begin(Begun(**{name: value for name, value in values.items() if name != "kind"}))
        elif kind == VOID:
            begun = replace(
                self.open[values["query"], values["replicate"]], params=values["params"], seed=values["seed"]
            )
            ended = {name: values[name] for name in ("word", "reason", "trace", "seconds")}
            self.void(Void(begun, **ended), line.get(lines.TRACE_SUM))
        else:
            self.end((values["query"], values["replicate"]))
