"""A ``certify`` line is for one requirement or for all, and there is only one of each."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import Diagnostic, suggestion
from s2r_spec.lang.parsing import Parsed


def certify_targets(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report lines for an unknown requirement, and second lines for a known one."""
    required = [item.name.text for item in parsed.statements if isinstance(item, syntax.Require)]
    unparsed = {broken.name for broken in parsed.broken}
    first: dict[str, syntax.Word] = {}
    general: syntax.Certify | None = None
    for item in parsed.statements:
        if not isinstance(item, syntax.Certify):
            continue
        word = item.name
        if word is None:
            if general is not None:
                message = "there is already a certify line for all requirements"
                yield Diagnostic(
                    "E15", message, item.span, general.span, "put all settings on one certify line"
                )
            general = general or item
            continue
        if word.text in unparsed:
            continue
        if word.text not in required:
            guess = suggestion(word.text, required)
            fix = guess or f"write `require {word.text}: …` first"
            yield Diagnostic("E15", f"there is no requirement `{word.text}`", word.span, fix=fix)
        elif word.text in first:
            message = f"`{word.text}` already has a certify line"
            yield Diagnostic(
                "E15", message, word.span, first[word.text].span, "put all settings on one certify line"
            )
        first.setdefault(word.text, word)
