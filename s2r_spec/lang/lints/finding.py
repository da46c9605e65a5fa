"""The record of a lint, and the walk over a file that all lints use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

from s2r_spec.lang import syntax
from s2r_spec.lang.parsing import Parsed
from s2r_spec.lang.source import Span

CODES = {
    "L01": "a temporal operator stands before and, or or ->; tools differ in its scope",
    "L02": "and and or are mixed without brackets",
    "L03": "implications are chained without brackets",
    "L04": "the robustness of == is never positive",
    "L05": "a bound is multiplied by a sign that can be 0",
    "L06": "a declaration is not used",
    "L07": "a condition always or never holds in the declared range of a signal",
    "L08": "a lengthscale is longer than the range of its parameter",
}
"""Stable codes: a code never changes its meaning."""


@dataclass(frozen=True)
class LintWarning:
    """One warning.

    Args:
        code: a key of :data:`CODES`.
        message: one sentence without a full stop.
        span: the place.
        fix: the text to write instead.
        edits: (position, text to insert), which do not change the meaning.
    """

    code: str
    message: str
    span: Span
    fix: str = ""
    edits: tuple[tuple[int, str], ...] = ()

    def __str__(self) -> str:
        picture = f"warning[{self.code}]: {self.message}\n{self.span.picture()}"
        margin = " " * len(str(self.span.line))
        return f"{picture}\n{margin} = {self.fix}" if self.fix else picture


def nodes(parsed: Parsed) -> Iterator[syntax.Node]:
    """Yield every node of a file, in the order of the text."""
    stack: list[object] = list(reversed(parsed.statements))
    while stack:
        node = stack.pop()
        if isinstance(node, tuple):
            stack.extend(reversed(node))
        elif isinstance(node, syntax.Node):
            yield node
            stack.extend(reversed([getattr(node, item.name) for item in fields(node)]))


def has_brackets(node: syntax.Node) -> bool:
    """Whether a node stands in brackets of its own."""
    text, span = node.span.source.text, node.span
    return text[: span.start].rstrip().endswith("(") and text[span.end :].lstrip().startswith(")")


def brackets(node: syntax.Node) -> tuple[tuple[int, str], ...]:
    """Return the edits that put a node in brackets."""
    return (node.span.start, "("), (node.span.end, ")")
