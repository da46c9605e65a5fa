"""Equality of measured numbers."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import Document
from s2r_spec.lang.lints.finding import LintWarning, nodes
from s2r_spec.lang.parsing import Parsed


def equality(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """The robustness of ``a == b`` is −abs(a − b): at best 0, and then any noise breaks it."""
    for node in nodes(parsed):
        if isinstance(node, syntax.Comparison):
            for k, word in enumerate(node.operators):
                if word.text == "==":
                    left, right = (
                        " ".join(operand.span.text.split()) for operand in node.operands[k : k + 2]
                    )
                    message = "the robustness of `==` is never positive"
                    yield LintWarning(
                        "L04", message, word.span, f"give a tolerance: `abs({left} - {right}) <= tolerance`"
                    )
