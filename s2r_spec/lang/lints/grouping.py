"""Operators whose grouping differs between tools; brackets make it explicit."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import Document
from s2r_spec.lang.lints.finding import LintWarning, brackets, has_brackets, nodes
from s2r_spec.lang.parsing import Parsed


def temporal_reach(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``always p and q`` is ``(always p) and q`` here, and ``always (p and q)`` in MoonLight."""
    for node in nodes(parsed):
        if not isinstance(node, syntax.Junction | syntax.Implication):
            continue
        word = node.operator
        for operand in node.operands[:-1] if isinstance(node, syntax.Junction) else (node.left,):
            if isinstance(operand, syntax.Temporal) and not has_brackets(operand) and _open(operand):
                message = (
                    f"the scope of `{operand.operator}` ends before `{word}`; in MoonLight it goes further"
                )
                yield LintWarning("L01", message, operand.span, "put it in brackets", brackets(operand))


def _open(node: syntax.Temporal) -> bool:
    """Return whether no bracket shows the end of a temporal operator or of the operators right after it."""
    inner: syntax.Expression = node
    while isinstance(inner, syntax.Temporal | syntax.AdjacentSample | syntax.Negation):
        inner = inner.operand
        if has_brackets(inner):
            return False
    return True


def mixed_junction(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``p and q or r`` is ``(p and q) or r``."""
    for node in nodes(parsed):
        if isinstance(node, syntax.Junction) and node.operator == "or":
            for operand in node.operands:
                if (
                    isinstance(operand, syntax.Junction)
                    and operand.operator == "and"
                    and not has_brackets(operand)
                ):
                    message = "`and` binds tighter than the `or` beside it"
                    yield LintWarning("L02", message, operand.span, "put it in brackets", brackets(operand))


def chained_implication(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``p -> q -> r`` is ``p -> (q -> r)`` here, and ``(p -> q) -> r`` in RTAMT."""
    for node in nodes(parsed):
        if isinstance(node, syntax.Implication) and node.operator == "->":
            right = node.right
            if isinstance(right, syntax.Implication) and right.operator == "->" and not has_brackets(right):
                message = "`->` groups to the right in s2r, and to the left in RTAMT"
                yield LintWarning("L03", message, right.span, "put it in brackets", brackets(right))
