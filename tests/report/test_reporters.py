import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import jsonschema
import pytest

from s2r_spec.certify.bound.rounding import interval_text
from s2r_spec.errors import UsageError
from s2r_spec.report import REPORTERS, reporter
from s2r_spec.report import check as check_report
from s2r_spec.report.records.schema import schema
from tests.errors import naming, states

NASTY = 'a<b & "c" | `d` *e* [f] %0A::error $x$ \x07 é漢字🤖\nsecond line'


def nasty(pair):
    """The same result with names as no grammar allows them, for a reporter has to bear anything."""
    spec, result = pair
    provenance = result.provenance | {"spec": NASTY, "backend": "b" * 3000}
    return spec, replace(result, reason=NASTY, folder=Path(f"runs/{NASTY}"), provenance=provenance)


@pytest.fixture
def report(holds, violated, undecided, refused):
    return check_report.report([holds, violated, undecided, refused])


def test_every_format_tells_every_requirement_and_the_worst_exit_code(report):
    assert report.exit_code == 1
    for name, render in REPORTERS.items():
        assert render(report).count("walking") >= 4, name


def test_the_text_is_what_the_record_says(holds):
    _, result = holds
    shown = reporter("text")(check_report.report([holds]))
    assert states(shown.splitlines()[0], "walking  HOLDS", "a spec.stl", "toy")
    assert states(shown, f"{interval_text(result.lower, result.upper)} m/s", "1 − 0.001")
    assert f"s2r replay {result.folder}#{result.lowest.query}.{result.lowest.replicate}" in shown


def test_json_is_what_the_schema_says(report):
    found = json.loads(reporter("json")(report))
    jsonschema.validate(found, schema("s2r.check/1"))
    assert [one["verdict"] for one in found["results"]] == ["holds", "violated", "unknown", "unknown"]
    assert found["results"][3]["label"] == "refused"
    assert found["locations"]["walking"] == {"file": "specs/a spec.stl", "line": 4}


@pytest.mark.parametrize(
    "damage",
    [
        lambda one: one.pop("label"),
        lambda one: one.update(verdict="passed"),
        lambda one: one.update(extra=1),
        lambda one: one["worst"].update(mean=None),
        lambda one: one["search"]["ladder"].clear(),
    ],
)
def test_the_schema_notices_a_damaged_object(holds, damage):
    found = json.loads(reporter("json")(check_report.report([holds])))
    damage(found["results"][0])
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found, schema("s2r.check/1"))


def test_json_never_holds_nan(holds):
    spec, result = holds
    with pytest.raises(ValueError, match="nan"):
        reporter("json")(check_report.report([(spec, replace(result, lower=float("nan")))]))


def test_junit_counts_and_places_failures_and_errors(report):
    suite = ET.fromstring(reporter("junit")(report)).find("testsuite")
    assert {key: suite.get(key) for key in ("tests", "failures", "errors")} == {
        "tests": "4",
        "failures": "1",
        "errors": "2",
    }
    cases = suite.findall("testcase")
    assert {(case.get("file"), case.get("line")) for case in cases} == {("specs/a spec.stl", "4")}
    assert [next((child.tag, child.get("type")) for child in case) for case in cases] == [
        ("system-out", None),
        ("failure", "violated"),
        ("error", "unknown"),
        ("error", "refused"),
    ]
    assert "ρ ≤ -0." in cases[1].find("failure").get("message")
    assert "R = 0.02" in cases[1].find("failure").text


def test_github_annotates_the_line_of_the_requirement(report):
    lines = reporter("github")(report).splitlines()
    assert [line.split(" ")[0] for line in lines] == ["::notice", "::error", "::error", "::error"]
    assert lines[1].startswith("::error file=specs/a spec.stl,line=4,title=walking VIOLATED::")


def test_markdown_has_a_table_and_the_replay_lines(report):
    shown = reporter("markdown")(report)
    assert shown.count("\n| walking |") == 4
    assert "**VIOLATED**" in shown
    assert shown.count("```sh\ns2r replay ") == 4


def test_nothing_in_a_name_is_markup(holds):
    report = check_report.report([nasty(holds)])
    for name, render in REPORTERS.items():
        assert "漢字🤖" in render(report), name
    assert "[f]" in reporter("text")(report)
    case = ET.fromstring(reporter("junit")(report)).find("testsuite/testcase")
    assert 'a<b & "c" | `d` *e* [f] %0A::error $x$ \\u0007' in case.find("system-out").text
    assert len(reporter("github")(report).splitlines()) == 1
    shown = reporter("markdown")(report)
    assert 'a&lt;b &amp; "c" \\| \\`d\\` \\*e\\* \\[f\\]' in shown
    assert not re.search(r"^second line", shown.split("```sh")[0], re.M)


def test_the_replay_line_is_fit_for_a_shell(holds):
    import shlex

    _, result = holds
    line = replace(result, folder=Path("runs/it's 5 o'clock; rm")).replay
    assert shlex.split(line)[2].startswith("runs/it's 5 o'clock; rm#")
    assert len(shlex.split(line)) == 3


def test_a_format_that_there_is_not_lists_those_that_there_are():
    with pytest.raises(UsageError, match=naming("'jnuit'", "did you mean 'junit'", "github, json")):
        reporter("jnuit")
