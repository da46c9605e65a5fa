"""Declarations that nothing refers to."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import Document
from s2r_spec.lang.lints.finding import LintWarning, nodes
from s2r_spec.lang.parsing import Parsed


def unused_signal(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """A trace need not have an unused signal. A searched parameter is used by the backend."""
    used = {node.name for node in nodes(parsed) if isinstance(node, syntax.Name)}
    used |= {node.name.text for node in nodes(parsed) if isinstance(node, syntax.Index)}
    for statement in parsed.statements:
        if isinstance(statement, syntax.Signal | syntax.Param | syntax.Const | syntax.Let):
            word = statement.name
            param = document.params.get(word.text)
            if param is not None and param.searched:
                continue
            if word.text not in used:
                yield LintWarning("L06", f"`{word.text}` is not used", word.span, "remove it")
