"""A name is declared once."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import Diagnostic
from s2r_spec.lang.parsing import Parsed


def unique_names(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report every second declaration of a name; signals, parameters, lets and requirements share one namespace."""
    first: dict[str, syntax.Word] = {}
    for item in parsed.statements:
        if isinstance(item, syntax.Certify):
            continue
        word = item.name
        if word.text in first:
            yield Diagnostic(
                "E08",
                f"`{word.text}` is declared twice",
                word.span,
                first[word.text].span,
                "give one of them another name",
            )
        first.setdefault(word.text, word)
