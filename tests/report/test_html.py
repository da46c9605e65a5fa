import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from s2r_spec import logs
from s2r_spec.base import errors
from s2r_spec.errors import UsageError
from s2r_spec.report import html
from s2r_spec.report.recompute import recompute
from s2r_spec.runs.layout import runs_in
from tests.conftest import rewrite
from tests.errors import naming, states
from tests.report.conftest import invented, undrawn

VOID = {"meta", "br", "hr", "img", "link", "input", "wbr", "source"}
TWO = """\
signal x {m}
param  goal_x {m} in [-1, 1]
param  goal_y {m} in [0, 3]
require reaches: always[0, 1 s] (x <= 1)
certify reaches: delta = 1e-2, epsilon = 0.3, B = 3, R = 0.02, kernel = rbf(1 {m}, 2 {m}), fall = -1
"""
THREE = TWO.replace("require", "param  load {kg} in [0, 5]\nrequire").replace("2 {m})", "2 {m}, 4 {kg})")


class Page(HTMLParser):
    """Balanced tags, names given once, pictures that say what they show; a place where a name may break is no text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.ids, self.pictures, self.fetched, self.words = [], [], [], [], []
        self.breaks = False
        self.feed(text)
        self.close()
        assert not self.open
        assert len(self.ids) == len(set(self.ids))
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.breaks = tag == "wbr"
        if tag not in VOID:
            self.open.append(tag)
        if "id" in attributes:
            self.ids.append(attributes["id"])
        if tag == "svg":
            assert attributes["role"] == "img"
            self.pictures.append(attributes["aria-label"])
        for key in ("src", "href", "xlink:href"):
            if not (attributes.get(key) or "#").startswith(("#", "data:")):
                self.fetched.append(attributes[key])

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.words.append(f"{self.words.pop()}{data}" if self.breaks else data)
        self.breaks = False


@pytest.fixture(scope="module")
def runs(holds, violated, undecided, refused):
    return [recompute(result.folder) for _, result in (holds, violated, undecided, refused)]


@pytest.fixture(scope="module")
def pages(runs):
    """The words of a page for each run."""
    with undrawn():
        return [html.render([run]) for run in runs]


def test_a_run_recomputed_from_its_folder_is_the_run(holds, violated, undecided, refused, runs):
    for (_, result), again in zip((holds, violated, undecided, refused), runs, strict=True):
        assert replace(again.result, seconds=0.0) == replace(result, seconds=0.0)
        assert again.history[-1].rollouts == len(again.records)
        assert again.waiting == 0


def test_the_page_is_whole_small_offline_and_the_same_again(runs):
    first = html.render(runs[:1])
    for text, count in ((first, 1), (html.render(runs[1:3]), 2)):
        assert len(text.encode()) < 1_000_000
        page = Page(text)
        assert not page.fetched
        assert "://" not in text.replace("http://www.w3.org/1999/xlink", "")
        assert "#1aa0" not in text  # every colour became a variable
        assert len(page.pictures) == 4 * count
        assert all(page.pictures)
    assert html.render([recompute(runs[0].result.folder)]) == first


def test_the_verdict_and_the_bound_come_first(pages):
    holds, violated, undecided, refused = (Page(page).text for page in pages)
    assert re.search(r"^.{0,120}✓ HOLDS .{0,40}ρ ≥ \+0\.\d+ m/s.{0,40}1 − 0.001", holds)
    assert re.search(r"^.{0,120}✗ VIOLATED .{0,40}ρ ≤ -0\.\d+ m/s.{0,40}1 − 0.001", violated)
    assert re.search(r"^.{0,120}\? UNKNOWN .{0,40}\[-0\.\d+, \+0\.\d+\] m/s", undecided)
    assert re.search(r"^.{0,120}\? UNKNOWN \(refused\) .{0,80}R = 0.001", refused)
    assert "1 − 0.001" not in refused
    assert "B = 4 m/s [" in holds
    assert "s2r replay " in holds
    assert "spec_hash" in holds


def test_the_critical_instant_is_told(runs, pages):
    record = runs[1].result.lowest
    reason = runs[1].spec.explain(logs.read(runs[1].result.folder / record.trace), "walking", record.params)
    text = Page(pages[1]).text
    assert re.search(rf"t = {reason.instant:g} s.{{0,20}}abs\(vx - vd\) <= -0\.05 \{{m/s\}}", text)


def test_a_run_that_was_cut_off_is_reported_as_far_as_it_is_whole(undecided, tmp_path):
    folder = tmp_path / "walking"
    shutil.copytree(undecided[1].folder, folder)
    journal = folder / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:-3]) + lines[-1][:20])
    run = recompute(folder)
    assert 0 < run.waiting < 8
    assert run.history[-1].rollouts + run.waiting == len(lines) - 4
    with undrawn():
        assert states(html.render([run]), f"{run.waiting} rollouts")
    journal.write_text("".join(lines[:4]))
    assert not (run := recompute(folder)).history
    with undrawn():
        assert "UNKNOWN" in Page(html.render([run])).text
    journal.write_text(lines[0])
    with pytest.raises(UsageError, match=naming(str(folder))):
        recompute(folder)


def test_traces_that_are_gone_are_done_without(undecided, tmp_path):
    shutil.copytree(undecided[1].folder, tmp_path / "walking", ignore=shutil.ignore_patterns("*.npz"))
    with undrawn():
        gone = Page(html.render([recompute(tmp_path / "walking")]))
    assert len(gone.pictures) == 2
    assert "trace" in gone.text


def test_a_rollout_at_another_test_is_not_told(undecided, tmp_path):
    shutil.copytree(undecided[1].folder, tmp_path / "walking")
    rewrite(tmp_path / "walking", lambda line: line | ({"params": {"vd": 0.123}} if "params" in line else {}))
    with pytest.raises(UsageError, match=naming(str(tmp_path / "walking"), "0.123")):
        recompute(tmp_path / "walking")


@pytest.mark.parametrize(
    ("text", "axes"), [(TWO, "maps over goal_x and goal_y"), (THREE, "along goal_x, goal_y, load")]
)
def test_more_parameters_are_maps_and_slices(tmp_path, text, axes):
    run = invented(tmp_path / "r", text, budget=60)
    text = html.render([run])
    page = Page(text)
    assert axes in page.pictures[0]
    assert "crash" in page.text
    assert html.render([run]) == text


def test_names_are_text_whatever_they_are(runs):
    nasty = '<script>alert("x")</script> & $x$ 漢字🤖 ' + "long" * 500
    run = runs[0]
    provenance = run.result.provenance | {"backend": nasty}
    result = replace(run.result, reason=nasty, unit="<b>", provenance=provenance)
    text = html.render([replace(run, result=result)])
    assert "<script" not in text
    assert nasty in Page(text).text
    assert "漢字🤖" in text


def test_where_runs_are(holds, tmp_path):
    folder = holds[1].folder
    assert runs_in(folder) == [folder]
    assert runs_in(folder.parent) == [folder]
    with pytest.raises(UsageError, match=naming(str(tmp_path), "journal.jsonl")):
        runs_in(tmp_path)


def test_without_the_extra_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=naming("jinja2", "matplotlib", "pip install", "[report]")):
        html.require_packages()
