"""The result as GitHub workflow commands, one annotation at the line of each requirement."""

from __future__ import annotations

from pathlib import Path

from s2r_spec.base.printable import one_line
from s2r_spec.base.verdict import Tone
from s2r_spec.report.finding import Finding, Report


def render(report: Report) -> str:
    """Return one line for each requirement: a notice if it holds, else an error."""
    return "\n".join(_line(one) for one in report.findings)


def _line(finding: Finding) -> str:
    level = "notice" if finding.verdict.tone is Tone.GOOD else "error"
    properties = {
        "file": one_line(Path(finding.location.file).as_posix()),
        "line": str(finding.location.line),
        "title": f"{finding.name} {finding.word}",
    }
    where = ",".join(f"{name}={_property(value)}" for name, value in properties.items())
    message = f"{finding.reason}: {finding.headline}\nreplay: {finding.replay}"
    return f"::{level} {where}::{_data(message)}"


def _data(words: str) -> str:
    return words.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(words: str) -> str:
    return _data(words).replace(":", "%3A").replace(",", "%2C")
