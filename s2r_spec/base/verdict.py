"""Verdicts on requirements, and the tone that verdicts of every command have in common.

A form of report maps a tone to its own sign or colour. The exit code of a command follows from the tone, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Literal, Self


class Tone(Enum):
    """What a verdict means to its reader, best first; the value is the exit code of the command."""

    _value_: Literal[0, 1, 3]

    GOOD = 0
    OPEN = 3
    BAD = 1


class Toned(Enum):
    """A verdict; the value is the printed word."""

    _value_: str
    tone: Tone

    def __new__(cls, word: str, tone: Tone) -> Self:
        """Make a verdict from its word and its tone."""
        verdict = object.__new__(cls)
        verdict._value_, verdict.tone = word, tone
        return verdict

    @property
    def exit_code(self) -> Literal[0, 1, 3]:
        """The exit code of a command with this verdict."""
        return self.tone.value


class Verdict(Toned):
    """Whether the requirement holds; the value is the printed word."""

    HOLDS = "holds", Tone.GOOD
    VIOLATED = "violated", Tone.BAD
    UNKNOWN = "unknown", Tone.OPEN

    @classmethod
    def of(cls, satisfied: bool | None) -> Verdict:
        """Return the verdict on a requirement that is true or false; None means that this is open."""
        return cls.UNKNOWN if satisfied is None else cls.HOLDS if satisfied else cls.VIOLATED


def worst(verdicts: Iterable[Toned]) -> Toned:
    """Return the worst of several verdicts: violated, then unknown, then holds."""
    return max(verdicts, key=lambda verdict: [*Tone].index(verdict.tone))
