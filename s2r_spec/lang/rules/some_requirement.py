"""A specification has at least one requirement."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import Diagnostic
from s2r_spec.lang.parsing import Parsed
from s2r_spec.lang.source import Span


def some_requirement(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report a file without a ``require`` line, unless a statement did not parse."""
    if any(isinstance(item, syntax.Require) for item in parsed.statements) or parsed.broken:
        return
    end = len(parsed.source.text.rstrip())
    place = Span(parsed.source, max(0, end - 1), end)
    fix = "add a line such as `require slow: always (v <= 1 {m/s})`"
    yield Diagnostic("E10", "this specification has no requirement", place, fix=fix)
