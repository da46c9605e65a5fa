"""Places in a specification, and the excerpt that shows one."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cached_property

from s2r_spec.base.printable import one_line

_WIDEST_LINE = 110


@dataclass(frozen=True)
class Source:
    """The text of a specification, with only line feeds, and its name in messages."""

    text: str
    name: str = "<string>"

    @classmethod
    def of(cls, text: str, name: str = "<string>") -> Source:
        """Make a source; every line ending becomes a line feed."""
        return cls(text.replace("\r\n", "\n").replace("\r", "\n"), name)

    @cached_property
    def starts(self) -> list[int]:
        """Index of the first character of each line, computed once."""
        return [0, *(place + 1 for place, sign in enumerate(self.text) if sign == "\n")]

    def line(self, number: int) -> str:
        """Return the text of a line, counted from 1."""
        start = self.starts[number - 1]
        end = self.text.find("\n", start)
        return self.text[start:] if end < 0 else self.text[start:end]


@dataclass(frozen=True)
class Span:
    """Characters ``start`` up to ``end`` of a source."""

    source: Source = field(repr=False, compare=False)
    start: int
    end: int

    @property
    def text(self) -> str:
        """The characters of the span."""
        return self.source.text[self.start : self.end]

    @property
    def line(self) -> int:
        """Line of the first character, counted from 1."""
        return bisect_right(self.source.starts, self.start)

    @property
    def column(self) -> int:
        """Column of the first character, counted from 1."""
        return self.start - self.source.starts[self.line - 1] + 1

    @property
    def place(self) -> str:
        """Line and source, for a sentence: "line 3 of a.stl"."""
        return f"line {self.line} of {self.source.name}"

    def to(self, other: Span) -> Span:
        """Return the span from the start of this one to the end of ``other``."""
        return Span(self.source, self.start, other.end)

    def picture(self, label: str = "") -> str:
        """Return an excerpt: name and position, the line, and a caret under each character.

        For a span over several lines it is the first line. A very long line is cut around the caret.
        """
        line = self.source.line(self.line).replace("\t", " ")
        column = self.column - 1
        length = max(1, min(self.end - self.start, len(line) - column))
        if len(line) > _WIDEST_LINE:
            first = max(0, column - _WIDEST_LINE // 2)
            line = "…" + line[first : first + _WIDEST_LINE] + "…"
            column += 1 - first
            length = min(length, len(line) - column)
        number = str(self.line)
        margin = " " * len(number)
        caret = " " * column + "^" * length
        return "\n".join(
            (
                f"{margin}--> {one_line(self.source.name)}:{self.line}:{self.column}",
                f"{margin} |",
                f"{number} | {one_line(line)}".rstrip(),
                f"{margin} | {caret} {label}".rstrip(),
            )
        )
