"""The README says what the repository does."""

import json
import re
from pathlib import Path

import pytest

import s2r_spec as s2r
from s2r_spec.certify.bound.rounding import interval_text
from tests import forked
from tests.errors import states

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
SAMPLE = re.search(r"<!-- output of: (s2r check .*?) -->\n```text\n(.*?)\n```", README, re.S)


def test_the_output_shown_is_the_one_that_the_committed_benchmark_got():
    """Same seed, same spec, same model: the same certificate, or the README is out of date."""
    shown = SAMPLE[2]
    result = json.loads((ROOT / "benchmarks" / "results" / "dense_reference.json").read_text())
    certificate = result["certificate"]
    assert f"{interval_text(certificate['lower'], certificate['upper'])} m/s" in shown
    assert f"{certificate['rollouts']} rollouts at" in shown
    assert f"spec {result['spec_hash'][:12]}, model {result['model_hash'][:12]}" in shown
    assert certificate["label"] in shown


def test_the_promise_shown_is_the_one_that_the_committed_run_got():
    """Its command, its numbers; a new model or another search makes it run again."""
    kept = json.loads((ROOT / "benchmarks" / "results" / "readme_certify.json").read_text())
    shown = re.search(
        rf"<!-- output of: {re.escape(kept['command'])};.*?-->\n```text\n(.*?)\n```", README, re.S
    )[1]
    result = kept["result"]
    promise, checked, gap = result["promise"], result["simulation"], result["gap"]
    simulated, worst = checked["worst_expected_robustness"], gap["worst_expected_gap"]
    lines = shown.splitlines()
    for facts in (
        (f"{interval_text(promise['lower'], promise['upper'])} m/s", "twin:lab"),
        (f"vd = {promise['worst']['vd']:.4g} m/s",),
        (
            f"{interval_text(simulated['lower'], simulated['upper'])} m/s",
            f"{checked['search']['rollouts']} rollouts",
            checked["label"],
        ),
        (f"{interval_text(worst['lower'], worst['upper'])} m/s",),
        (interval_text(gap["band"]["low"], gap["band"]["high"]),),
        (gap["label"],),
    ):
        assert any(states(line, *facts) for line in lines), facts
    hashes = {result[side]["provenance"]["spec_hash"] for side in ("simulation", "gap")}
    assert hashes == {s2r.load_spec(ROOT / "specs" / "a1_velocity.stl").hash}


def test_the_committed_reference_lies_in_the_certificates_interval():
    result = json.loads((ROOT / "benchmarks" / "results" / "dense_reference.json").read_text())
    worst = min(row["mean"] for row in result["reference"])
    assert len(result["reference"]) >= 11
    assert worst == result["reference_minimum"]["mean"]
    assert result["certificate"]["lower"] <= worst <= result["certificate"]["upper"]


def test_the_committed_reference_is_of_the_committed_spec():
    result = json.loads((ROOT / "benchmarks" / "results" / "dense_reference.json").read_text())
    assert s2r.load_spec(ROOT / "specs" / "a1_velocity.stl").hash == result["spec_hash"]


def test_the_spec_shown_is_the_spec_in_the_folder():
    shown = re.search(r"without its comments:\n\n```\n(.*?)```", README, re.S)[1]
    text = (ROOT / "specs" / "a1_velocity.stl").read_text()
    code = "\n".join(line for line in re.sub(r"\s*#.*", "", text).splitlines() if line.strip())
    assert re.sub(r"\s+", " ", shown.strip()) == re.sub(r"\s+", " ", code)


def test_every_link_into_the_repository_leads_somewhere():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("which", ["main job", "test"])
def test_the_two_commands_are_one_line_each(which):
    command = re.search(rf"<!-- {which} -->\n```sh\n(.*?)\n```", README, re.S)[1]
    assert len(command.splitlines()) == 1
    assert "pip install" in command


def test_the_first_command_prints_what_is_shown():
    command, shown = re.search(
        r"<!-- output of: s2r (monitor .*?) -->\n```text\n(.*?)```", README, re.S
    ).groups()
    assert f".venv/bin/s2r {command}\n" in README
    assert forked.run(command.split(), ROOT).stdout == shown


def test_the_library_example_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs" / "how-to" / "runs.md").read_text()
    exec(re.search(r"## From Python\n\n```python\n(.*?)```", page, re.S)[1], {})
    assert re.match(r"\{'walking': 0\.0\d+\}", capsys.readouterr().out)
