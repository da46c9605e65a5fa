"""The figures of the documentation on diagnoses are those of the committed results."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.blind.table import (
    HISTORY,
    LATEST,
    PAGE,
    SETS,
    by_size,
    first,
    history,
    reliability,
    table,
)
from benchmarks.diagnosis_tables import TABLES
from s2r_spec.blind.score import truth
from s2r_spec.diagnose.gap.held_out import LEVEL
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.remainder import Remainder
from s2r_spec.spec import load_spec

ROOT = Path(__file__).parents[2]
METHOD = PAGE.with_name("diagnosis-method.md")
RESULTS = ROOT / "benchmarks" / "blind" / "results"


def cases_of(*sets):
    return [c for s in sets for c in json.loads((RESULTS / f"{s}_scores.json").read_text())["cases"].values()]


def test_the_tables_of_sealed_sets_are_what_the_committed_command_prints():
    page = PAGE.read_text()
    for made in (table(), by_size(), reliability()):
        assert made in page
    assert history() in HISTORY.read_text()
    every = {f"{name}_scores.json" for names in SETS.values() for name in names}
    assert every == {path.name for path in RESULTS.glob("*_scores.json")}
    assert {names[-1] for names in SETS.values()} <= set(LATEST)


@pytest.mark.parametrize("made", TABLES, ids=lambda made: made.__name__)
def test_the_other_tables_are_what_the_committed_command_prints(made):
    assert made() in PAGE.read_text()


def test_the_page_on_logs_has_the_rate_of_sure_answers():
    sure = [case for case in cases_of(*LATEST) if first(case)[1] >= 0.9]
    right = sum(first(case)[0] == truth(case["label"]) for case in sure)
    page = (ROOT / "docs" / "how-to" / "diagnose-logs.md").read_text()
    assert f"{right} of {len(sure)} cases" in " ".join(page.split())


def test_the_page_on_logs_has_the_size_of_a_few_percent_of_every_effect():
    page = " ".join((ROOT / "docs" / "how-to" / "diagnose-logs.md").read_text().split())
    assert f"{100 * BACKGROUND:.0f} % of" in page
    assert f"{20 * LEVEL:.0f} in 20" in page


def test_the_page_on_logs_shows_what_was_printed_for_a_gust():
    gusts = [case for case in cases_of("car2") if "gust" in case["label"]["effects"]]
    said = [str(Remainder(**case["left"][0])) for case in gusts]
    page = " ".join((ROOT / "docs" / "how-to" / "diagnose-logs.md").read_text().split())
    assert any(f"*{words}*" in page for words in said), said


def unknown_seen(*sets):
    """Return how many unknown causes with a material gap were seen as such, and how many there were."""
    scores = [json.loads((RESULTS / f"{name}_scores.json").read_text())["scores"] for name in sets]
    return tuple(
        sum(one["unknown with a material gap detected"][key] for one in scores) for key in ("hits", "of")
    )


def test_the_page_on_effects_has_the_rate_of_unknown_causes_without_residuals():
    hits, of = unknown_seen("car2", "car")
    page = " ".join((ROOT / "docs" / "how-to" / "effects.md").read_text().split())
    assert f"{hits} of {of}" in page


def test_the_page_has_the_rate_of_windows():
    rate = json.loads((RESULTS / "emps10_scores.json").read_text())["scores"][
        "at least 80% of Δρ in the window in which the effect acts"
    ]
    assert f"In {rate['hits']} of {rate['of']}, " in " ".join(PAGE.read_text().split())


def test_every_set_was_frozen_before_it_was_opened():
    found = sorted(RESULTS.glob("*_scores.json"))
    assert found
    for path in found:
        kept = json.loads(path.read_text())
        manifest = json.loads((RESULTS / path.name.replace("_scores", "_manifest")).read_text())
        assert kept["frozen"] == manifest["frozen"] <= kept["opened"]
        assert sorted(manifest["answers"]) == sorted(kept["cases"])
        assert re.fullmatch(r"[0-9a-f]{64}", manifest["code"])


def test_the_diagnosis_of_the_real_go2_agrees_with_a_least_squares_fit():
    kept = json.loads((ROOT / "benchmarks" / "real" / "go2_diagnose.json").read_text())
    fit = json.loads((ROOT / "benchmarks" / "real" / "go2_fit.json").read_text())
    dry, _, armature = fit["of_kinds"].values()
    for name, values in (("dry_friction", dry), ("armature", armature)):
        for joint, value in values.items():
            assert kept["parameters"][name][joint]["low"] < value < kept["parameters"][name][joint]["high"]
    assert kept["verdict"] == "confounded"


def test_true_values_of_the_twins_are_in_their_intervals():
    kept = json.loads((ROOT / "benchmarks" / "results" / "twins_diagnose.json").read_text())["twins"]
    assert set(kept) == {"lab", "grass", "sand", "ramp"}
    for place, found in kept.items():
        for effect, values in found["has"].items():
            for name, value in values.items():
                estimate = found["parameters"].get(effect, {}).get(name, {"low": value, "high": value})
                assert estimate["low"] <= value <= estimate["high"], (place, effect)


def test_what_the_readme_shows_of_a_diagnosis_is_what_the_committed_run_printed():
    kept = json.loads((ROOT / "benchmarks" / "results" / "twins_diagnose.json").read_text())["twins"]["lab"]
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


def test_the_diagnosis_of_the_real_axis_contains_the_documented_friction():
    kept = json.loads((ROOT / "benchmarks" / "real" / "emps_diagnose.json").read_text())
    found = kept["friction"]["parameters"]
    for effect in ("viscous", "coulomb"):
        for name, value in kept["documented"][effect].items():
            assert found[effect][name]["low"] < value < found[effect][name]["high"]
    assert found["speed_filter"]["time"]["low"] > 0.0007
    assert "offset" not in kept["friction"]["set"]
    before, after = kept["friction"]["control law leaves"]
    assert after <= 0.1 * before
    assert kept["pulses"]["verdict"] == "none of these"


def test_the_method_has_the_rates_of_effects_of_one_kind():
    done = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / "blind" / "kin.py"],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    every, clear = re.findall(r"(\d+ of \d+)", done.stdout.splitlines()[-1])
    page = " ".join(METHOD.read_text().split())
    right, of = every.split(" of ")
    assert f"there were {of} " in page
    assert f"in {right}, " in page
    assert f"in {clear} (`python benchmarks/blind/kin.py`)" in page
