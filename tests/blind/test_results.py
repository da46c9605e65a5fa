"""The figures of the documentation on diagnoses are those of the committed results."""

import json
import re
from pathlib import Path

import pytest

from s2r_spec.spec import load_spec

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "blind" / "results"


SETS = ("turtlebot", "emps", "quad", "car", "segway", "arm", "a1")


def test_the_page_has_the_scores_of_the_sealed_sets():
    page = (ROOT / "docs" / "explanation" / "diagnosis.md").read_text()
    lines = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")]
    rows = {cells[0].strip("| "): [cell.strip(" |") for cell in cells[1:]] for cells in lines}
    scores = [json.loads((RESULTS / f"{name}_scores.json").read_text())["scores"] for name in SETS]
    for words, key in {
        "effects of at least 0.25 that are named": "must be named, and are",
        "effects below 0.125 that are not named": "must not be named, and are not",
        "machines with a false name": "machines with a false name",
        "exit code 0, and something large is missing or false": "exit 0, and something large is missing or false",
        "large sizes in their 90 % intervals": "large sizes in the 90 % interval",
        "unknown causes called *none of these*": "unknown: none of these",
        "healthy twins without a name": "healthy: nothing named",
    }.items():
        assert rows[words] == [one[key] for one in scores]
    error = "size error, rms, median over effects"
    assert rows["rms error of a size, median over effects"] == [f"{one[error]:.3f}" for one in scores]
    baselines = json.loads((RESULTS / "baselines.json").read_text())
    for words, method in {
        "least squares of all sizes, the largest named": "joint",
        "the best single effect": "single",
        "the best single effect for ρ alone": "rho",
    }.items():
        each = [baselines[name][method] for name in SETS]
        cells = [f"{one['must be named, and are']}; {one['machines with a false name']}" for one in each]
        assert rows[f"{words}: named; false names"] == cells


def test_the_manifests_are_those_of_the_opened_answers():
    for name in SETS:
        manifest = json.loads((RESULTS / f"{name}_manifest.json").read_text())
        scored = json.loads((RESULTS / f"{name}_scores.json").read_text())
        assert scored["frozen"] == manifest["frozen"]
        assert scored["frozen"] < scored["opened"]
        assert scored["cases"].keys() == manifest["answers"].keys()


def test_the_page_has_the_ablation_of_the_error_model():
    kept = json.loads((ROOT / "benchmarks" / "results" / "ablation.json").read_text())
    page = (ROOT / "docs" / "explanation" / "diagnosis.md").read_text()
    assert f"| of {kept['cases'] * len(kept['machines'])} machines |" in page
    keys = (
        "must be named, and are",
        "machines with a false name",
        "large sizes in the 90 % interval",
    )
    for name, row in kept["rows"].items():
        cells = " | ".join([*(row[key] for key in keys), f"{row['log score, known and healthy']:.2f}"])
        assert f"| {name} | {cells} |" in page


def test_the_page_has_the_figures_of_the_calibration():
    score = json.loads((ROOT / "benchmarks" / "results" / "diagnosis_calibration.json").read_text())["all"]
    page = (ROOT / "docs" / "explanation" / "diagnosis.md").read_text()
    for words, group, count in (
        ("sizes of at least 0.25 in their 90 % intervals", "large", score["large sizes"]),
        ("other sizes in their 90 % intervals", "others", score["other sizes"]),
    ):
        share = 100 * score[f"{group}, in the interval"]["90 %"]
        assert f"| {words} | {share:.0f} % of {count} |" in page
    for place, one in zip(
        ("below 0.05", "of 0.05 to 0.5", "of 0.5 to 0.95", "above 0.95"),
        score["effects by probability"],
        strict=True,
    ):
        cell = f"{round(one['are large'] * one['effects'])} of {one['effects']}"
        assert f"| effects with a probability {place} that are large | {cell} |" in page


@pytest.mark.xfail(strict=True, reason="all effects close a little less than the fit by joint, and than 75 %")
def test_the_diagnosis_of_the_real_go2_closes_as_much_as_a_least_squares_fit():
    kept, fit = (
        json.loads((ROOT / "benchmarks" / "results" / name).read_text())
        for name in ("go2_diagnose.json", "go2_fit.json")
    )
    closed = kept["how_far"]["tuned_share"]["estimate"]
    assert closed >= 0.75
    assert closed > fit["of_each_joint_closes"]


def test_the_page_has_the_figures_of_the_real_go2():
    kept, fit = (
        json.loads((ROOT / "benchmarks" / "results" / name).read_text())
        for name in ("go2_diagnose.json", "go2_fit.json")
    )
    far = kept["how_far"]
    named, closed = far["share"]["estimate"], far["tuned_share"]["estimate"]
    assert far["rollouts"] == fit["held_out"]
    assert far["before"]["mean"] == pytest.approx(fit["gap_before"], abs=1e-3)
    assert kept["answer"] == ["dry_friction", "action_delay"]
    friction, fitted = kept["parameters"]["dry_friction"], fit["of_kinds"]["dry_friction"]
    assert max(fitted, key=lambda kind: friction[kind]["estimate"]) == "calf"
    words = " ".join((ROOT / "docs" / "explanation" / "diagnosis.md").read_text().split())
    shares = [fit[f"{name}_closes"] for name in ("of_kinds", "of_each_joint", "by_position")]
    kinds, joints, position, ours, all_effects = (
        f"{100 * share:.0f} %" for share in (*shares, named, closed)
    )
    assert f"closes {ours} of the held-out gap. All effects together close {all_effects}" in words
    assert f"closes {kinds}, one with the friction of each joint {joints}, and one whose friction" in words
    assert f"with the joint's position {position}" in words


@pytest.mark.xfail(strict=True, reason="the armature and the viscous friction of the real Go2 are not found")
def test_the_diagnosis_of_the_real_go2_has_the_values_of_a_least_squares_fit():
    kept = json.loads((ROOT / "benchmarks" / "results" / "go2_diagnose.json").read_text())
    fit = json.loads((ROOT / "benchmarks" / "results" / "go2_fit.json").read_text())["of_kinds"]
    pairs = [(kept["parameters"][effect][kind], x) for effect, own in fit.items() for kind, x in own.items()]
    assert all(one["low"] < value < one["high"] for one, value in pairs)


@pytest.mark.xfail(strict=True, reason="on sand, the friction of the ground is ruled out beside its creep")
def test_true_values_of_the_twins_are_in_their_intervals():
    kept = json.loads((ROOT / "benchmarks" / "results" / "twins_diagnose.json").read_text())["twins"]
    assert set(kept) == {"lab", "grass", "sand", "ramp"}
    for place, found in kept.items():
        for effect, values in found["has"].items():
            for name, value in values.items():
                estimate = found["parameters"].get(effect, {}).get(name, {"low": value, "high": value})
                assert estimate["low"] <= value <= estimate["high"], (place, effect)


def test_what_the_readme_shows_of_a_diagnosis_is_what_the_committed_run_printed():
    kept = json.loads((ROOT / "benchmarks" / "results" / "twins_diagnose.json").read_text())["twins"]["ramp"]
    readme = (ROOT / "README.md").read_text()
    shown = re.search(
        rf"<!-- output of: {re.escape(kept['command'])};.*?-->\n```text\n(.*?)\n```", readme, re.S
    )
    assert shown is not None
    printed = kept["text"].splitlines()
    for line in shown[1].splitlines():
        assert line in printed, line
    assert f"takes about {round(kept['cpu_seconds'], -1)} s of one core" in " ".join(readme.split())
    assert kept["spec_hash"] == load_spec(ROOT / "specs" / "a1_velocity.stl").hash


@pytest.mark.xfail(strict=True, reason="the speed filter of the real axis comes out too short")
def test_the_diagnosis_of_the_real_axis_contains_the_documented_friction():
    kept = json.loads((ROOT / "benchmarks" / "results" / "emps_diagnose.json").read_text())
    found = kept["friction"]["parameters"]
    for effect in ("viscous", "coulomb"):
        for name, value in kept["documented"][effect].items():
            assert found[effect][name]["low"] < value < found[effect][name]["high"]
    assert found["speed_filter"]["time"]["low"] > 0.0007
    assert "offset" not in kept["friction"]["set"]
    before, after = kept["friction"]["control law leaves"]
    assert after <= 0.1 * before
    assert kept["pulses"]["verdict"] == "none of these"
