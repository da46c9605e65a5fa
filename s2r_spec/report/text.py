"""The result as text for a terminal."""

from __future__ import annotations

from rich.markup import escape
from rich.text import Text

from s2r_spec.report.finding import Finding, Report
from s2r_spec.verdict import Tone

STYLES = {Tone.GOOD: "bold green", Tone.BAD: "bold red", Tone.OPEN: "bold yellow"}


def render(report: Report) -> str:
    """Return plain text."""
    return Text.from_markup(markup(report)).plain


def markup(report: Report) -> str:
    """Return the same as rich markup, for a terminal."""
    return "\n\n".join(
        f"{escape(one.name)}  [{STYLES[one.verdict.tone]}]{one.word}[/]  ({escape(one.about)})\n"
        f"{escape(body(one))}"
        for one in report.findings
    )


def body(finding: Finding) -> str:
    """Return all but the first line of a finding, as plain text."""
    lines = [f"  {finding.reason}", "", *(f"  {name:17} {text}" for name, text in finding.facts), ""]
    for title, rows in finding.sections:
        lines += [f"  {title}:", *(f"   - {row}" for row in rows)]
    lines += ["", f"  {finding.provenance}", f"  replay the {finding.again}:  {finding.replay}"]
    return "\n".join(lines)
