"""Formulas of the random logs: predicates, operators, their text, and their margins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

INF = float("inf")


@dataclass(frozen=True)
class Leaf:
    """``value op level``, where value is x, abs(x), x − y or abs(x − y); ``op`` "flag" is the truth value x."""

    names: tuple[str, ...]
    absolute: bool
    op: str
    level: float

    def text(self) -> str:
        value = " - ".join(self.names)
        if self.op == "flag":
            return value
        return f"({f'abs({value})' if self.absolute else value} {self.op} {self.level!r})"

    def value(self, values: Sequence[float]) -> float:
        difference = values[0] - values[1] if len(values) == 2 else values[0]
        return abs(difference) if self.absolute else difference

    def margin(self, value: float) -> float:
        if self.op == "flag":
            return INF if value > 0 else -INF
        return self.level - value if self.op[0] == "<" else value - self.level

    def truth(self, value: float, shift: float = 0.0) -> float:
        """Return ±inf: whether it is true, or its margin is above a shift that is not 0."""
        if self.op == "flag" or shift:
            return INF if self.margin(value) > shift else -INF
        margin = self.margin(value)
        return INF if margin > 0 or (margin == 0 and self.op[1:] == "=") else -INF


@dataclass(frozen=True)
class Node:
    """An operator, with its window [ms] if it has one; the window is closed, and its end may be infinite."""

    op: str
    parts: tuple[Formula, ...]
    low: float = 0.0
    high: float = INF

    def text(self) -> str:
        parts = [part.text() for part in self.parts]
        bounded = f"[{self.low} ms, {self.high} ms]" if self.high < INF else ""
        match self.op:
            case "not" | "rise":
                return f"{self.op}({parts[0]})"
            case "and" | "or" | "->":
                return f"({parts[0]} {self.op} {parts[1]})"
            case "until":
                return f"({parts[0]} until{bounded} {parts[1]})"
            case _:
                return f"{self.op}{bounded} ({parts[0]})"


Formula = Leaf | Node


def leaves(formula: Formula) -> list[Leaf]:
    """Return the predicates of a formula."""
    if isinstance(formula, Leaf):
        return [formula]
    return [leaf for part in formula.parts for leaf in leaves(part)]


def names(formula: Formula) -> tuple[str, ...]:
    """Return the signals of a formula, each once."""
    return tuple(dict.fromkeys(name for leaf in leaves(formula) for name in leaf.names))


def edges(formula: Formula) -> list[Node]:
    """Return the edges in a formula."""
    if isinstance(formula, Leaf):
        return []
    return [formula] * (formula.op == "rise") + [one for part in formula.parts for one in edges(part)]


def windows(formula: Formula) -> list[tuple[float, float]]:
    """Return the ends of all windows of a formula [ms]."""
    if isinstance(formula, Leaf):
        return []
    own = [] if formula.op in ("not", "and", "or", "->", "rise") else [(formula.low, formula.high)]
    return [*own, *(one for part in formula.parts for one in windows(part))]


def needed(formula: Formula) -> float:
    """Return how long after an instant a log must last to decide a formula there [ms]."""
    if isinstance(formula, Leaf):
        return 0.0
    below = max(map(needed, formula.parts))
    end = formula.low if formula.high == INF else formula.high
    match formula.op:
        case "always" | "eventually" | "until":
            return end + below
        case "once" | "historically":
            return max(0.0, below - formula.low)
        case _:
            return below
