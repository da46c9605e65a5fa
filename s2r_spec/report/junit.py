"""The result as JUnit XML, as GitLab, Jenkins and GitHub's test reporters read it.

A violated requirement is a failure. An unknown one, or one whose certificate was refused, is an error.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

from s2r_spec.base.printable import one_line
from s2r_spec.base.verdict import Verdict
from s2r_spec.report import text
from s2r_spec.report.finding import Finding, Report

# Characters that XML 1.0 forbids and ElementTree does not refuse.
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def render(report: Report) -> str:
    """Return one test suite with one test case for each requirement."""
    counts = {
        "tests": str(len(report.findings)),
        "failures": str(_count(report, Verdict.VIOLATED)),
        "errors": str(_count(report, Verdict.UNKNOWN)),
        "time": f"{sum(one.seconds for one in report.findings):.3f}",
    }
    root = ET.Element("testsuites", {"name": report.command} | counts)
    suite = ET.SubElement(root, "testsuite", {"name": report.command} | counts | {"skipped": "0"})
    for finding in report.findings:
        _case(suite, finding)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode")


def _count(report: Report, verdict: Verdict) -> int:
    return sum(one.verdict is verdict for one in report.findings)


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
