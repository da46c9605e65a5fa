"""Warnings about legal text that is seldom meant: one function for each lint, grouped by subject.

A lint states the meaning of a text in s2r, its meaning in other tools, and an unambiguous way to write it.
If brackets are enough, the lint has the edit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from s2r_spec.lang.checking import check_text
from s2r_spec.lang.declarations import Document
from s2r_spec.lang.imports import imported_names
from s2r_spec.lang.lints.equality import equality
from s2r_spec.lang.lints.finding import LintWarning
from s2r_spec.lang.lints.grouping import chained_implication, mixed_junction, temporal_reach
from s2r_spec.lang.lints.lengthscale import long_lengthscale
from s2r_spec.lang.lints.ranges import settled_by_range
from s2r_spec.lang.lints.signs import vanishing_sign
from s2r_spec.lang.lints.unused import unused_signal
from s2r_spec.lang.parsing import Parsed, parse
from s2r_spec.lang.source import Source

LINTS: tuple[Callable[[Parsed, Document], Iterator[LintWarning]], ...] = (
    temporal_reach, mixed_junction, chained_implication, equality, vanishing_sign, unused_signal, settled_by_range,
    long_lengthscale,
)  # fmt: skip


def lint(text: str, name: str = "<string>") -> tuple[LintWarning, ...]:
    """Return the findings of all lints in a specification, in the order of the text.

    Raises:
        SpecError: the text has mistakes.
    """
    document = check_text(text, name)
    source = Source.of(text, name)
    parsed = parse(source, imported_names(source))
    findings = [finding for rule in LINTS for finding in rule(parsed, document)]
    return tuple(sorted(findings, key=lambda finding: (finding.span.start, finding.code)))


def apply_fixes(text: str, findings: Iterable[LintWarning]) -> str:
    """Return the text with every edit of the findings; its meaning stays the same."""
    text = Source.of(text).text
    edits = sorted((edit for finding in findings for edit in finding.edits), reverse=True)
    for place, inserted in edits:
        text = text[:place] + inserted + text[place:]
    return text
