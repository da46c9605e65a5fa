"""Formats, files and pages of ``s2r check`` and ``s2r report``, in one process each."""

import json
from xml.etree import ElementTree as ET

import jsonschema
import pytest

from s2r_spec.report.records.schema import schema
from tests.errors import states


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (("--format", "jnuit"), ["'jnuit'", "did you mean 'junit'"]),
        (("--json", "--format", "text"), ["--json", "--format text"]),
        (("--report", "nowhere/out.html"), ["nowhere/out.html", "folder"]),
        (("--output", "."), [" .", "folder"]),
    ],
)
def test_what_cannot_be_written_is_said_before_anything_runs(s2r, words, facts):
    done = s2r("check", s2r.spec(), "-b", "toy", *words, code=2)
    assert states(done.stderr, *facts), done.stderr
    assert not (s2r.folder / "s2r-runs").exists()


def test_a_check_with_a_page_and_its_report_again(s2r):
    words = ("--run", "r", "--format", "junit", "--report", "out.html")
    done = s2r("check", s2r.spec(-0.05), "-b", "toy", *words, code=1)
    suite = ET.fromstring(done.stdout).find("testsuite")
    assert suite.get("failures") == "1"
    assert suite.find("testcase").get("file") == "spec.stl"
    page = (s2r.folder / "out.html").read_bytes()

    again = s2r("report", "r", code=1)
    assert again.stdout == "r/report.html\n"
    assert (s2r.folder / "r" / "report.html").read_bytes() == page
    words = ("--format", "json", "--output", "out.json")
    assert s2r("report", "r/walking", *words, code=1).stdout == ""
    found = json.loads((s2r.folder / "out.json").read_text())
    jsonschema.validate(found, schema("s2r.check/1"))
    assert found["locations"] == {"walking": {"file": "r/walking/spec.stl", "line": 3}}


def test_a_folder_without_a_run(s2r):
    assert " ." in s2r.json("report", ".", code=2)["error"]
