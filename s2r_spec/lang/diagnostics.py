"""The mistakes of a specification: one record for each, and one exception for all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from s2r_spec.base.errors import UsageError, did_you_mean
from s2r_spec.base.printable import lines, one_line
from s2r_spec.lang.source import Span

CODES = {
    "E01": "the text does not follow the grammar",
    "E02": "a name is not declared",
    "E03": "two units do not match",
    "E04": "a unit is not known",
    "E05": "a condition is used as a number, or a number as a condition",
    "E06": "a time interval is empty, negative or not a time",
    "E07": "a declaration takes the short name of an operator",
    "E08": "a name is declared twice",
    "E09": "a range is missing or empty",
    "E10": "the specification has no requirement",
    "E11": "operators that do not associate are chained",
    "E12": "a certify setting is unknown or given twice",
    "E13": "a certify setting is outside its valid range",
    "E14": "a kernel is unknown, or its lengthscales do not fit the parameters",
    "E15": "a certify line has no requirement of its own",
    "E16": "a function is unknown, or has the wrong arguments",
    "E17": "a vector is used as a number, or an index is out of range",
    "E18": "a number must be constant and finite",
    "E19": "a formula is nested too deeply",
    "E20": "a unit with an offset, such as degC, is used like one without",
    "E21": "a file cannot be imported",
    "E22": "the text is too long",
}
"""Stable codes: a code never changes its meaning."""

MOST_SHOWN = 20
"""Budget: mistakes that a message shows, about three screens."""
LONGEST = 400
"""Budget: letters of a message, four lines of a terminal."""


@dataclass(frozen=True)
class Diagnostic:
    """One mistake: its message, place, related declaration and remedy.

    Args:
        code: a key of :data:`CODES`.
        message: one sentence without a full stop.
        span: place of the mistake.
        declared_at: place of the declaration that the mistake is about, if any.
        fix: the remedy, as an instruction.
    """

    code: str
    message: str
    span: Span
    declared_at: Span | None = None
    fix: str = ""

    def __post_init__(self) -> None:
        """Shorten a message that quotes a very long text."""
        for name in ("message", "fix"):
            text = getattr(self, name)
            if len(text) > LONGEST:
                object.__setattr__(self, name, f"{text[: LONGEST - 1]}…")

    def __str__(self) -> str:
        label = "" if self.declared_at is None else f"declared at line {self.declared_at.line}"
        picture = f"error[{self.code}]: {one_line(self.message)}\n{self.span.picture(label)}"
        margin = " " * len(str(self.span.line))
        return f"{picture}\n{margin} = {one_line(self.fix)}" if self.fix else picture


def suggestion(name: str, names: Iterable[str]) -> str:
    """Return "did you mean `vx`?" when one of ``names`` is close, else an empty string."""
    return did_you_mean(name, names).removeprefix("; ").replace("'", "`")


class SpecError(UsageError):
    """A specification is wrong; ``diagnostics`` holds every mistake, in the order of the text."""

    def __init__(self, diagnostics: Iterable[Diagnostic]) -> None:
        self.diagnostics = tuple(
            sorted(
                diagnostics,
                key=lambda item: (item.span.source.name, item.span.start, item.span.end, item.code),
            )
        )
        count = len(self.diagnostics)
        name = self.diagnostics[0].span.source.name
        head = f"{count} mistake{'s' if count > 1 else ''} in {name}"
        shown = list(map(str, self.diagnostics[:MOST_SHOWN]))
        if count > MOST_SHOWN:
            shown.append(f"and {count - MOST_SHOWN} more; correct these first")
        super().__init__("\n\n".join((one_line(head), *shown)))

    def __str__(self) -> str:
        return lines(Exception.__str__(self))
