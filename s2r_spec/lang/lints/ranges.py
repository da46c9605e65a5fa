"""Conditions that always or never hold in the declared range of a signal."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import formula as f
from s2r_spec.lang.constants import constant
from s2r_spec.lang.declarations import Document
from s2r_spec.lang.lints.finding import LintWarning
from s2r_spec.lang.parsing import Parsed

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


def settled_by_range(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``v <= 60`` always holds for a signal declared in [-50, 50]."""
    seen: set[int] = set()
    for formula in document.requirements.values():
        for node in f.walk(formula):
            if isinstance(node, f.Comparison) and id(node) not in seen and node.operator in _MIRRORED:
                seen.add(id(node))
                yield from _range_warnings(node, document)


def _range_warnings(node: f.Comparison, document: Document) -> Iterator[LintWarning]:
    for operand, other, operator in (
        (node.left, node.right, node.operator),
        (node.right, node.left, _MIRRORED[node.operator]),
    ):
        bound = constant(other)
        range_ = document.signals[operand.name].range if isinstance(operand, f.SignalValue) else None
        if bound is None or range_ is None or not isinstance(operand, f.SignalValue):
            continue
        low, high = range_ if operator[0] == "<" else (-range_[1], -range_[0])
        limit = bound if operator[0] == "<" else -bound
        if high <= limit or low > limit:
            holds = "always" if high <= limit else "never"
            text = " ".join(node.span.text.split())
            message = (
                f"`{text}` {holds} holds: `{operand.name}` is declared in [{range_[0]:g}, {range_[1]:g}]"
            )
            yield LintWarning("L07", message, node.span, "change the bound, or the range")
