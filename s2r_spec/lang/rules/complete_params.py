"""A parameter has a range, a default, or both."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import Diagnostic
from s2r_spec.lang.parsing import Parsed


def complete_params(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report every ``param`` without a range and a default."""
    for item in parsed.statements:
        if isinstance(item, syntax.Param) and item.range is None and item.default is None:
            unit = "" if item.unit is None else f" {{{item.unit.text}}}"
            yield Diagnostic(
                "E09",
                f"the parameter `{item.name.text}` has neither a range nor a default",
                item.name.span,
                fix=f"write `param {item.name.text}{unit} in [low, high]` or `= value`",
            )
