"""What is wrong with a specification: one record a mistake, one exception for all of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from s2r_spec.errors import UsageError, did_you_mean
from s2r_spec.lang.source import Span
from s2r_spec.printable import lines, one_line

CODES = {
    "E01": "the text does not follow the grammar",
    "E02": "a name is not declared",
    "E03": "two units do not go together",
    "E04": "a unit is not known",
    "E05": "a condition stands where a number is needed, or the other way round",
    "E06": "a time interval is empty, negative or not a time",
    "E07": "the short name of an operator is taken by a declaration",
    "E08": "a name is declared twice",
    "E09": "a range is missing, or is no range",
    "E10": "nothing is required",
    "E11": "operators that do not associate are chained",
    "E12": "a certify setting is unknown or given twice",
    "E13": "a certify setting is outside what it can be",
    "E14": "a kernel is unknown, or its length scales do not fit the parameters",
    "E15": "a certify line has no requirement of its own",
    "E16": "a function is unknown, or takes other arguments",
    "E17": "a vector stands where a number is needed, or an index is outside it",
    "E18": "a number is needed that is finite and known before any trace",
    "E19": "a formula is nested too deeply",
    "E20": "a unit with an offset is used like one without",
    "E21": "a file cannot be imported",
    "E22": "a text is too long",
}
"""Stable codes: a code never changes its meaning."""

MOST_SHOWN = 20
"""Mistakes that a message draws (budget: about three screens); twice as many make it twice as long."""
LONGEST = 400
"""Letters of a message (budget: four lines of a terminal); twice as many show more of a very long name."""


@dataclass(frozen=True)
class Diagnostic:
    """One mistake: what it is, where, which declaration it refers to, and what to do.

    Args:
        code: a key of :data:`CODES`.
        message: one sentence without a full stop.
        span: where the mistake stands.
        declared_at: the declaration that the mistake is about, if there is one.
        fix: what would be right, as an instruction.
    """

    code: str
    message: str
    span: Span
    declared_at: Span | None = None
    fix: str = ""

    def __post_init__(self) -> None:
        """Cut what repeats very long words of a text."""
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
            shown.append(f"and {count - MOST_SHOWN} more; mend these first")
        super().__init__("\n\n".join((one_line(head), *shown)))

    def __str__(self) -> str:
        return lines(Exception.__str__(self))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the diagnostics: a worker process may be the one that fails."""
        return SpecError, (self.diagnostics,)
