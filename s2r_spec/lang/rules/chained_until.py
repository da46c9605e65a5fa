"""``until`` does not associate: ``a until b until c`` has no agreed meaning."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import Diagnostic
from s2r_spec.lang.parsing import Parsed


def chained_until(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report the second operator of every chain."""
    stack: list[syntax.Node] = list(parsed.statements)
    while stack:
        node = stack.pop()
        if isinstance(node, syntax.Until) and len(node.links) > 1:
            first, second = node.links[0].word.span.text, node.links[1].word.span
            fix = f"write `(a {first} b) {second.text} c` or `a {first} (b {second.text} c)`"
            yield Diagnostic(
                "E11", f"`{second.text}` after `{first}` could be read in two ways", second, fix=fix
            )
        for value in vars(node).values():
            parts = value if isinstance(value, tuple) else (value,)
            stack += [part for part in parts if isinstance(part, syntax.Node)]
