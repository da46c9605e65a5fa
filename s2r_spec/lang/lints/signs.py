"""Bounds multiplied by a sign."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import Document
from s2r_spec.lang.lints.finding import LintWarning, nodes
from s2r_spec.lang.parsing import Parsed


def vanishing_sign(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``sign(vd) * (v - vd) <= tol`` says nothing at vd = 0."""
    for node in nodes(parsed):
        if isinstance(node, syntax.Arithmetic) and node.operator.text == "*":
            for operand in (node.left, node.right):
                if (
                    isinstance(operand, syntax.Call)
                    and operand.function.text == "sign"
                    and _can_vanish(operand, document)
                ):
                    argument = " ".join(operand.span.text.split()).removeprefix("sign(").removesuffix(")")
                    message = f"where `{argument}` is 0, its sign is 0, too, and the product bounds nothing"
                    fix = f"use `overshoot(x, {argument.strip()})`, whose direction is never 0"
                    yield LintWarning("L05", message, operand.span, fix)


def _can_vanish(call: syntax.Call, document: Document) -> bool:
    """Return whether the argument may be 0, judged by a parameter's range."""
    (argument,) = call.arguments
    param = document.params.get(argument.name) if isinstance(argument, syntax.Name) else None
    return param is None or param.range is None or param.range[0] <= 0 <= param.range[1]
