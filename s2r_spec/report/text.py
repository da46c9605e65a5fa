"""The result as text for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.text import Text

from s2r_spec.base.verdict import Tone

if TYPE_CHECKING:
    from s2r_spec.report.finding import Finding, Report

STYLES = {Tone.GOOD: "bold green", Tone.BAD: "bold red", Tone.OPEN: "bold yellow"}


def render(report: Report) -> str:
    """Return plain text."""
    return Text.from_markup(markup(report)).plain


def markup(report: Report, verbose: bool = True) -> str:
    """Return the same as rich markup, for a terminal; ``verbose`` as in :func:`body`."""
    return "\n\n".join(
        f"{escape(one.name)}  [{STYLES[one.verdict.tone]}]{one.word}[/]  ({escape(one.about)})\n"
        f"{escape(body(one, verbose))}"
        for one in report.findings
    )


def body(finding: Finding, verbose: bool = True) -> str:
    """Return all but the first line of a finding, as plain text.

    Without ``verbose`` it has no assumptions, no interval for each larger B, and no empty lines.
    """
    facts = [f"  {name:17} {text}" for name, text in finding.facts]
    again = f"  replay the {finding.again}:  {finding.replay}"
    if not verbose:
        more = f"  {finding.provenance}; -v prints the {len(finding.assumptions)} assumptions, and larger B"
        return "\n".join([f"  {finding.reason}", *facts, more, again])
    lines = [f"  {finding.reason}", "", *facts, ""]
    for title, rows in finding.sections:
        lines += [f"  {title}:", *(f"   - {row}" for row in rows)]
    return "\n".join([*lines, "", f"  {finding.provenance}", again])
