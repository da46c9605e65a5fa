"""The result for CI: JUnit XML as GitLab, Jenkins and GitHub's test reporters read it, and GitHub's annotations.

In JUnit a violated requirement is a failure. An unknown one, or one whose certificate was refused, is an error.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

from s2r_spec.base.printable import one_line
from s2r_spec.base.verdict import Tone, Verdict
from s2r_spec.report import text
from s2r_spec.report.finding import Finding, Report

# Characters that XML 1.0 forbids and ElementTree does not refuse.
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(report: Report) -> str:
    """Return one test suite with one test case for each requirement."""
    verdicts = [one.verdict for one in report.findings]
    counts = {
        "tests": str(len(verdicts)),
        "failures": str(verdicts.count(Verdict.VIOLATED)),
        "errors": str(verdicts.count(Verdict.UNKNOWN)),
        "time": f"{sum(one.seconds for one in report.findings):.3f}",
    }
    root = ET.Element("testsuites", {"name": report.command} | counts)
    suite = ET.SubElement(root, "testsuite", {"name": report.command} | counts | {"skipped": "0"})
    for finding in report.findings:
        _case(suite, finding)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode")


def _case(suite: ET.Element, finding: Finding) -> None:
    file = Path(finding.location.file)
    case = ET.SubElement(
        suite,
        "testcase",
        {
            "name": _legal(finding.name),
            "classname": _legal(one_line(file.stem)),
            "file": _legal(one_line(file.as_posix())),
            "line": str(finding.location.line),
            "time": f"{finding.seconds:.3f}",
        },
    )
    words = _legal(f"{finding.about}\n{text.body(finding)}\n")
    if finding.verdict is Verdict.HOLDS:
        ET.SubElement(case, "system-out").text = words
        return
    kind = "failure" if finding.verdict is Verdict.VIOLATED else "error"
    type_ = "refused" if finding.refused else finding.verdict.value
    message = _legal(f"{finding.reason}: {finding.headline}")
    ET.SubElement(case, kind, {"type": type_, "message": message}).text = words


def _legal(words: str) -> str:
    return _FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", words)


def github(report: Report) -> str:
    """Return one line for each requirement: a notice if it holds, else an error."""
    return "\n".join(_line(one) for one in report.findings)


def _line(finding: Finding) -> str:
    level = "notice" if finding.verdict.tone is Tone.GOOD else "error"
    properties = {
        "file": one_line(Path(finding.location.file).as_posix()),
        "line": str(finding.location.line),
        "title": f"{finding.name} {finding.word}",
    }
    escaped = {
        name: _data(value).replace(":", "%3A").replace(",", "%2C") for name, value in properties.items()
    }
    where = ",".join(f"{name}={value}" for name, value in escaped.items())
    message = f"{finding.reason}: {finding.headline}\nreplay: {finding.replay}"
    return f"::{level} {where}::{_data(message)}"


def _data(words: str) -> str:
    return words.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
