"""The declarations so far while a specification is checked, and the reporting of mistakes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NoReturn, TypeVar, cast

from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import Param, Signal
from s2r_spec.lang.diagnostics import Diagnostic, suggestion
from s2r_spec.lang.formula import Formula, Value
from s2r_spec.lang.source import Span
from s2r_spec.lang.units import PLAIN, Unit, UnknownUnitError, parse_unit

T = TypeVar("T")
R = TypeVar("R")


class Mistake(Exception):  # noqa: N818  (control flow within this package, never seen outside)
    """Ends the check of one statement; the check of the file continues."""

    def __init__(self, *diagnostics: Diagnostic) -> None:
        super().__init__(*diagnostics)
        self.diagnostics = diagnostics


def fail(code: str, message: str, span: Span, fix: str = "", declared_at: Span | None = None) -> NoReturn:
    """Raise a mistake with one diagnostic."""
    raise Mistake(Diagnostic(code, message, span, declared_at, fix))


def each(check: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Check every item even if an earlier one is wrong, then fail with all their mistakes."""
    checked: list[R] = []
    mistakes: list[Mistake] = []
    for item in items:
        try:
            checked.append(check(item))
        except Mistake as mistake:
            mistakes.append(mistake)
    if mistakes:
        raise Mistake(*(diagnostic for mistake in mistakes for diagnostic in mistake.diagnostics))
    return checked


def both(first: Callable[[], R], second: Callable[[], T]) -> tuple[R, T]:
    """Run two checks with results of different types, as :func:`each` does."""
    results: list[R | T] = each(lambda check: check(), cast(list[Callable[[], R | T]], [first, second]))
    return cast(tuple[R, T], tuple(results))


@dataclass(frozen=True)
class Definition:
    """The meaning of a name that ``const``, ``let`` or ``require`` defines."""

    body: Value | Formula
    span: Span


Declaration = Signal | Param | Definition


@dataclass
class Scope:
    """Names declared above the statement that is being checked.

    Args:
        declared: name → declaration.
        poisoned: names whose own declaration is wrong; their uses are not reported again.
        later: name → place of every declaration of the file, for the advice to move it up.
    """

    declared: dict[str, Declaration] = field(default_factory=dict)
    poisoned: set[str] = field(default_factory=set)
    later: dict[str, Span] = field(default_factory=dict)

    def find(self, name: str, span: Span) -> Declaration:
        """Return the declaration of ``name``, or fail at ``span``."""
        if name in self.declared:
            return self.declared[name]
        if name in self.poisoned:
            raise Mistake
        if name in self.later:
            message = f"`{name}` is used above its declaration"
            fail("E02", message, span, "move the declaration up", self.later[name])
        listed = ", ".join(f"`{known}`" for known in list(self.declared)[:8]) or "nothing"
        fix = suggestion(name, self.declared) or f"declare it; declared above: {listed}"
        fail("E02", f"`{name}` is not declared", span, fix)


def unit_of(word: syntax.Word | None) -> Unit:
    """Return the unit in braces; the plain unit if there are none."""
    if word is None:
        return PLAIN
    try:
        return parse_unit(word.text)
    except UnknownUnitError as error:
        part = str(error)
        message = f"`{part}` is not a unit" if part else "a unit is missing"
        fail("E04", message, word.span, "write a unit like {m/s}, {deg}, {N*m} or {1/s^2}; {} means no unit")
