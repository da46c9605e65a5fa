"""The result as Markdown, for ``$GITHUB_STEP_SUMMARY`` and pull requests."""

from __future__ import annotations

import re

from s2r_spec.base.printable import one_line
from s2r_spec.base.verdict import Tone
from s2r_spec.report.finding import Finding, Report

SIGNS = {Tone.GOOD: "✅", Tone.BAD: "❌", Tone.OPEN: "❓"}


def render(report: Report) -> str:
    """Return a table of verdicts, then the facts and assumptions of each."""
    head = ["| requirement | verdict | bound |", "| --- | --- | --- |"]
    rows = [
        f"| {cell(one.name)} | {SIGNS[one.verdict.tone]} **{cell(one.word)}** | {cell(one.headline)} |"
        for one in report.findings
    ]
    return "\n".join([f"### {cell(report.command)}", "", *head, *rows, *map(_details, report.findings)])


def _details(finding: Finding) -> str:
    lines = ["", f"**{cell(finding.name)}**: {cell(finding.reason)} ({cell(finding.about)})", ""]
    lines += [f"- {cell(name)}: {cell(text)}" for name, text in finding.facts]
    for title, rows in finding.sections:
        lines += ["", "<details>", f"<summary>{cell(title)}</summary>", ""]
        lines += [f"- {cell(row)}" for row in rows]
        lines += ["", "</details>"]
    # The fence is longer than any in the code.
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", finding.replay)), default=0))
    lines += ["", f"{cell(finding.provenance)}; replay the {cell(finding.again)}:", ""]
    return "\n".join([*lines, f"{fence}sh", finding.replay, fence])


def cell(words: str) -> str:
    """Return one line without active markup: Markdown and HTML characters are escaped."""
    line = one_line(" ".join(words.split())).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_{}\[\]|~#!$@])", r"\\\1", line)
