"""The tutorial on the gap and its cause does what it says.

Its diagnosis takes minutes, so the page shows what `benchmarks/diagnose/gap_and_cause.py` kept. A slow test repeats it.
"""

import json
import re
from pathlib import Path

import pytest

from tests import forked
from tests.test_tutorials import FILE, OUTPUT, agree, read_page

ROOT = Path(__file__).parents[1]
PAGE = read_page(ROOT / "docs" / "tutorials" / "gap-and-cause.md")
KEPT = json.loads((ROOT / "benchmarks" / "results" / "gap_and_cause.json").read_text(encoding="utf-8"))
SHOWN = re.search(
    r"```sh\n(s2r diagnose .*)\n```\n\n<!-- from: benchmarks/results/gap_and_cause.json -->\n```text\n(.*?)```",
    PAGE,
    re.S,
)


@pytest.fixture
def folder(tmp_path):
    """What a reader has after the first section."""
    for name, text in FILE.findall(PAGE):
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def bounds(text):
    """Return the bounds of the worst expected gap, and the worst mean gap of a test, in what `s2r gap` printed."""
    interval = re.search(r"worst expected Δ  in \[(\S+), (\S+)\]", text).groups()
    return [*map(float, interval), float(re.search(r"mean \|Δ\| (\S+)", text)[1])]


def test_the_diagnosis_shown_is_the_one_that_the_benchmark_kept():
    assert SHOWN[1] == KEPT["command"]
    for line in SHOWN[2].splitlines():
        assert line == "…" or line in KEPT["output"], line


def test_the_gap_is_as_shown_and_shrinks_with_the_effect(folder):
    (folder / "better.json").write_text(json.dumps(KEPT["patch"]), encoding="utf-8")
    found = []
    for typed, command, shown in OUTPUT.findall(PAGE):
        assert typed == command
        done = forked.run([*command.split(), "-q"], folder)
        assert done.returncode in (0, 3), done.stderr
        printed = done.stdout.splitlines()
        for line in shown.splitlines():
            assert line == "…" or any(agree(line, other) for other in printed), (line, printed)
        found.append(bounds(done.stdout))
    (lower, upper, worst), (lower_after, upper_after, worst_after) = found
    assert upper < 0  # the machine is worse than its simulator
    assert lower < lower_after < 0 < upper_after
    assert worst_after < worst / 3


@pytest.mark.slow
def test_the_diagnosis_names_the_cause_and_writes_the_simulator(folder, monkeypatch, cache):
    monkeypatch.setenv("S2R_CACHE", str(cache))
    forked.run(KEPT["command"].split()[1:], folder)
    patch = json.loads((folder / "better.json").read_text(encoding="utf-8"))
    assert patch["effects"].keys() == {"heading_bias"}
    assert patch["effects"]["heading_bias"]["angle"] == pytest.approx(-0.2, rel=0.15)
