"""The result as text for a terminal."""

from __future__ import annotations

from rich.markup import escape
from rich.text import Text

from s2r_spec.base.verdict import Tone
from s2r_spec.report.finding import Finding, Report

STYLES = {Tone.GOOD: "bold green", Tone.BAD: "bold red", Tone.OPEN: "bold yellow"}


def render(report: Report) -> str:
    """Return plain text."""
    return Text.from_markup(markup(report)).plain


def markup(report: Report, verbose: bool = True) -> str:
    """Return the same as rich markup, for a terminal; without ``verbose`` each finding is a :func:`summary`."""
    words = body if verbose else summary
    return "\n\n".join(
        f"{escape(one.name)}  [{STYLES[one.verdict.tone]}]{one.word}[/]  ({escape(one.about)})\n"
        f"{escape(words(one))}"
        for one in report.findings
    )


def body(finding: Finding) -> str:
    """Return all but the first line of a finding, as plain text."""
    lines = [f"  {finding.reason}", "", *_facts(finding), ""]
    for title, rows in finding.sections:
        lines += [f"  {title}:", *(f"   - {row}" for row in rows)]
    lines += ["", f"  {finding.provenance}", _again(finding)]
    return "\n".join(lines)


def summary(finding: Finding) -> str:
    """Return the same without the assumptions and the interval for each larger B, and without empty lines."""
    more = f"  {finding.provenance}; -v prints the {len(finding.assumptions)} assumptions, and larger B"
    return "\n".join([f"  {finding.reason}", *_facts(finding), more, _again(finding)])


def _facts(finding: Finding) -> list[str]:
    return [f"  {name:17} {text}" for name, text in finding.facts]


def _again(finding: Finding) -> str:
    return f"  replay the {finding.again}:  {finding.replay}"
