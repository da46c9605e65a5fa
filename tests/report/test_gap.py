"""Reports of s2r gap and s2r certify: from memory, and again from the folder alone."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import jsonschema
import pytest

from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.rounding import down, interval_text
from s2r_spec.certify.gap import gap as bound
from s2r_spec.errors import UsageError
from s2r_spec.report import REPORTERS, html, reporter
from s2r_spec.report import certify as certify_report
from s2r_spec.report import gap as gap_report
from s2r_spec.report.recompute import RunKind, kind, recompute_certify, recompute_gap
from s2r_spec.report.records.schema import schema
from s2r_spec.report.sections import bars
from s2r_spec.runs.task import open_backend
from tests.certify.logs import record_from
from tests.errors import naming, states
from tests.report.conftest import one_thread, plugin, spec_of, undrawn
from tests.report.test_html import Page
from tests.report.test_reporters import NASTY


def without_clock(result):
    """Drop the seconds, of all parts."""
    if result is None:
        return None
    kept = replace(result, seconds=0.0) if hasattr(result, "seconds") else result
    if hasattr(result, "simulated"):
        kept = replace(kept, simulated=without_clock(result.simulated), gap=without_clock(result.gap))
    return kept


def test_a_promise_recomputed_from_its_folder_is_the_promise(promised, unpromised, refused_in_simulation):
    for _, result, folder in (promised, unpromised, refused_in_simulation):
        again = recompute_certify(folder, result.real)
        assert without_clock(again.result) == without_clock(result)
    assert without_clock(recompute_gap(promised[2] / "gap").result) == without_clock(promised[1].gap)


def test_what_kind_of_run_a_folder_holds(promised, holds, tmp_path):
    folder = promised[2]
    assert kind(folder) is RunKind.CERTIFY
    assert kind(folder / "gap") is RunKind.GAP
    assert kind(folder / "simulation") is kind(holds[1].folder.parent) is RunKind.CHECK
    with pytest.raises(UsageError, match=naming(str(tmp_path))):
        kind(tmp_path)


def test_json_is_what_the_schema_says(promised, unpromised, refused_in_simulation):
    for spec, result, _ in (promised, unpromised, refused_in_simulation):
        found = json.loads(reporter("json")(certify_report.report(spec, result)))
        jsonschema.validate(found, schema("s2r.certify/1"))
        if result.gap is not None:
            found = json.loads(reporter("json")(gap_report.report(spec, result.gap)))
            jsonschema.validate(found, schema("s2r.gap/1"))


@pytest.mark.parametrize(
    "damage",
    [
        lambda one: one.pop("promise"),
        lambda one: one["promise"].update(lower="low"),
        lambda one: one["gap"].update(extra=1),
        lambda one: one["gap"]["search"].update(objective="-rho"),
        lambda one: one["simulation"]["search"]["ladder"].clear(),
    ],
)
def test_the_schema_notices_a_damaged_object(promised, damage):
    spec, result, _ = promised
    found = json.loads(reporter("json")(certify_report.report(spec, result)))
    damage(found)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found, schema("s2r.certify/1"))


def test_every_format_tells_the_verdict_and_the_bound(promised):
    spec, result, _ = promised
    bound = f"≥ {down(result.composition.lower)} m/s", "1 − 0.002"
    for name, render in REPORTERS.items():
        shown = render(certify_report.report(spec, result))
        assert "walking" in shown
        assert name in ("json", "text", "junit") or states(shown, *bound), name
    text = reporter("text")(certify_report.report(spec, result))
    assert states(text.splitlines()[0], "walking  HOLDS", "a spec.stl", "toy", "toy:drag")
    promise = result.composition
    assert states(
        text, f"{interval_text(promise.lower, promise.upper)} m/s", "toy:drag", "1 − 0.002", "B = 4 m/s"
    )


def test_a_gap_is_bounded_and_neither_holds_nor_fails(promised, unpromised):
    spec = promised[0]
    close, wide = (gap_report.report(spec, one.gap) for one in (promised[1], unpromised[1]))
    assert (close.exit_code, wide.exit_code) == (0, 3)
    assert "walking  BOUNDED  (" in reporter("text")(close)
    case = ET.fromstring(reporter("junit")(close)).find("testsuite/testcase")
    assert [child.tag for child in case] == ["system-out"]
    assert "::notice" in reporter("github")(close)
    assert wide.findings[0].verdict is Verdict.UNKNOWN
    assert wide.findings[0].word != "UNKNOWN"


def test_the_page_of_a_promise(promised):
    text = html.render([recompute_certify(promised[2])])
    page = Page(text)
    assert not page.fetched
    assert "://" not in text.replace("http://www.w3.org/1999/xlink", "")
    assert len(text.encode()) < 1_000_000
    assert re.search(r"^.{0,130}✓ HOLDS .{0,60}toy:drag.{0,30} ≥ \+0\.\d+ m/s.{0,40}1 − 0\.002", page.text)
    # Promise, gap, its interval, the worst pair, simulation, its interval.
    assert len(page.pictures) == 6
    lowest = promised[1].gap.lowest
    assert states(page.text, f"Pair {lowest.query}.{lowest.replicate}", f"Δ = {lowest.gap:+.4f} m/s")


def test_the_page_of_a_gap_and_of_a_refusal(promised, refused_in_simulation):
    with undrawn():
        page = Page(html.render([recompute_gap(promised[2] / "gap")]))
    assert re.search(r"^.{0,130}✓ BOUNDED .{0,40}Δ ≥ -0\.\d+ m/s.{0,40}1 − 0\.001", page.text)
    assert len(page.pictures) == 3
    _, result, folder = refused_in_simulation
    with undrawn():
        page = Page(html.render([recompute_certify(folder, result.real)]))
    assert re.search(r"^.{0,160}UNKNOWN.{0,60}toy:drag", page.text)
    assert "1 − 0.002" not in page.text


def test_a_fall_of_the_real_side_is_told(unpromised):
    spec, result, folder = unpromised
    assert result.gap.failures
    assert "fell [/leg]" in reporter("text")(certify_report.report(spec, result))
    with undrawn():
        page = Page(html.render([recompute_certify(folder)])).text
    assert "fell [/leg]" in page
    assert "UNKNOWN" in page


def test_a_gap_that_was_cut_off_is_reported_as_far_as_it_is_whole(promised, tmp_path):
    shutil.copytree(promised[2], tmp_path / "run")
    folder = tmp_path / "run" / "gap"
    journal = folder / "sim" / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:-3]))
    run = recompute_gap(folder)
    assert run.waiting > 0
    assert run.history[-1].rollouts + run.waiting == len(run.real)
    with undrawn():
        assert states(html.render([run]), f"{run.waiting} rollouts")
    journal.write_text(lines[0])
    with pytest.raises(UsageError, match=naming(str(folder))):
        recompute_gap(folder)


def test_recordings_are_drawn_where_they_lie(tmp_path):
    with plugin(), undrawn():
        log = record_from("toy:drag", [vd / 10 for vd in range(-2, 4)] * 2, tmp_path / "night")
        result = bound(spec_of(0.15), "toy", log, tmp_path / "gap", executor=one_thread)
        run = recompute_gap(tmp_path / "gap")
        assert without_clock(run.result) == without_clock(result)
        page = Page(html.render([run]))
        assert len(page.pictures) == 3
        assert states(page.pictures[2], "2", "toy")
        shutil.rmtree(tmp_path / "night")
        open_backend.cache_clear()
        page = Page(html.render([run]))
    assert len(page.pictures) == 2
    jsonschema.validate(
        json.loads(reporter("json")(gap_report.report(run.spec, result))), schema("s2r.gap/1")
    )


def test_nothing_in_a_name_is_markup(promised):
    spec, result, _ = promised
    gap = replace(result.gap, folder=Path(f"runs/{NASTY}"))
    nasty = replace(result, reason=NASTY, real=NASTY, gap=gap)
    for name, render in REPORTERS.items():
        assert "漢字🤖" in render(certify_report.report(spec, nasty)), name
    assert len(reporter("github")(certify_report.report(spec, nasty)).splitlines()) == 1
    assert certify_report.finding(spec, nasty).replay.count("'") == 2  # fit for a shell


def test_bars_share_one_line_with_0_on_it():
    first, second = bars([("a", -1.0, 1.0), ("b", 1.0, 3.0)], "m")
    assert first.zero == second.zero
    assert first.left < first.zero < first.left + first.width
    assert second.left == pytest.approx(first.left + first.width)
    assert second.words == "[+1.0000, +3.0000] m"
