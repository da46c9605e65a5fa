"""What the documentation says of the sealed sets is what was measured."""

import json
import re
import subprocess
import sys
from pathlib import Path

from benchmarks.blind.table import (
    HISTORY,
    LATEST,
    PAGE,
    SETS,
    UNASKED,
    by_size,
    first,
    history,
    reliability,
    table,
)
from s2r_spec.blind.score import truth
from s2r_spec.diagnose.axes import BACKGROUND
from s2r_spec.diagnose.held_out import SURELY_LESS
from s2r_spec.diagnose.judge import WEIGHTS
from s2r_spec.diagnose.remainder import Remainder
from s2r_spec.diagnose.told import ACROSS
from s2r_spec.spec import load_spec

ROOT = Path(__file__).parents[2]
METHOD = PAGE.with_name("diagnosis-method.md")
RESULTS = ROOT / "benchmarks" / "blind" / "results"


def right(case):
    """Whether the likeliest answer of a case is the truth."""
    return first(case)[0] == truth(case["label"])


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


def test_what_is_said_of_the_weights():
    page = " ".join(METHOD.read_text().split())
    assert (
        f"They are trusted by {WEIGHTS.trust:g}, by {WEIGHTS.beside:g} where the equations are heard" in page
    )
    assert f"is believed to seven tenths. The weight is {WEIGHTS.told:g}." in page
    assert WEIGHTS.evidence == 2.0
    assert "**evidence**, of step 5, which counts twice" in page
    sets = json.loads((RESULTS / "weigh.json").read_text())["sets"]
    for name, once, twice in (("car", 5, 10), ("quad", 9, 14)):
        tried = sets[name]
        assert (tried["1"]["more"], tried["2"]["more"]) == ([once, 20], [twice, 20])
        assert tried["1"]["single"] == tried["2"]["single"]
        wrong = [tried[weight]["sure"][1] - tried[weight]["sure"][0] for weight in ("1", "2")]
        assert wrong[1] <= wrong[0]
    assert sets["car"]["4"]["more"][0] > sets["car"]["2"]["more"][0]
    assert sets["quad"]["4"]["more"][0] < sets["quad"]["2"]["more"][0]
    assert sets["quad"]["2"]["log score"] < sets["quad"]["1"]["log score"]
    assert round(1.0 - ACROSS, 1) == 0.7


def test_what_is_said_of_answers_that_were_sure_and_wrong():
    page = " ".join(PAGE.read_text().split())
    sure = [case for case in cases_of(*LATEST) if first(case)[1] >= 0.9]
    wrong = [case["label"]["effects"] for case in sure if not right(case)]
    words = f"Of {len(sure)} answers of 0.9 and more {len(wrong)} are wrong"
    assert words in page, (words, wrong)
    assert {
        (case["label"]["kind"], *case["label"]["effects"]): set(first(case)[0])
        for case in sure
        if not right(case)
    } == {
        ("unknown", "dragging_foot"): {"foot_drag"},
        ("unknown", "weak_rear_rotor"): {"com_offset"},
        ("pair", "battery_sag", "ground_effect"): {"battery_sag"},
        ("single", "speed_filter"): {"stribeck"},
        ("single", "payload"): {"payload", "strength_decay"},
    }
    assert (
        "two causes that the catalogue lacks were named as members that do nearly the same (one foot that drags as all "
        "four, a weak rear rotor as a centre of mass), of two effects one was named, a machine with a slight filter on "
        "its speed was said to have a slight fall of friction, and one with a load to have motors that weaken beside "
        "it."
    ) in page


def test_what_is_said_of_what_no_equation_asked_for():
    since = [
        case
        for case in cases_of("a1seventeenth", "a1eighteenth", "a1nineteenth", "a1twentieth", "a1")
        if UNASKED & set(case["label"]["effects"])
    ]
    alone, beside = (
        [right(c) for c in since if (c["label"]["kind"] == "single") is one] for one in (True, False)
    )
    assert (
        f"of these alone {sum(alone)} of {len(alone)} were named in the five sets since, of these beside another "
        f"{sum(beside)} of {len(beside)}."
    ) in " ".join(PAGE.read_text().split())


def test_what_the_page_on_logs_says_of_sure_answers():
    sure = [case for case in cases_of(*LATEST) if first(case)[1] >= 0.9]
    right = sum(first(case)[0] == truth(case["label"]) for case in sure)
    page = (ROOT / "docs" / "how-to" / "diagnose-logs.md").read_text()
    assert f"{right} of {len(sure)} cases" in " ".join(page.split())


def test_what_the_page_on_logs_says_of_a_few_percent_of_every_effect():
    page = " ".join((ROOT / "docs" / "how-to" / "diagnose-logs.md").read_text().split())
    assert f"{100 * BACKGROUND:.0f} % of each effect's typical size" in page
    assert f"{20 * SURELY_LESS:.0f} in 20" in page


def test_what_the_page_on_logs_says_of_a_gust():
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


def test_what_is_said_of_unknown_causes_without_residuals():
    hits, of = unknown_seen("car2", "car")
    page = " ".join((ROOT / "docs" / "how-to" / "effects.md").read_text().split())
    assert f"{hits} of {of}" in page


def test_what_is_said_of_unknown_causes_before_and_since():
    (hits, of), (now, of_now) = unknown_seen("car1", "quad6"), unknown_seen("car2", "quad7", "car", "quad")
    page = " ".join(PAGE.read_text().split())
    assert (
        f"unknown causes in what is recorded: of theirs with a material gap {hits} of {of} were seen then, and {now} "
        f"of {of_now} in the two since."
    ) in page
    newest = [
        json.loads((RESULTS / f"{n[-1]}_scores.json").read_text())["scores"]
        for m, n in SETS.items()
        if m != "the arm"
    ]
    known = [one["known effects called unknown"] for one in newest]
    hits, of = (sum(one[key] for one in known) for key in ("hits", "of"))
    assert (hits, f"of their {of} known machines one was called unknown" in page) == (1, True), (hits, of)


def test_what_is_said_of_windows():
    rate = json.loads((RESULTS / "emps10_scores.json").read_text())["scores"][
        "at least 80% of Δρ in the window in which the effect acts"
    ]
    assert f"acts in {rate['hits']} of {rate['of']} cases of the axis' tenth set" in " ".join(
        PAGE.read_text().split()
    )


def test_what_is_said_of_the_worst_test():
    both = json.loads((ROOT / "benchmarks" / "results" / "where_worst.json").read_text())
    kept, twin = both["emps"]["summary"], both["emps_twin"]["summary"]
    page = " ".join(PAGE.read_text().split())
    near, enough = ([twin[how][what] for how in ("diagnosis", "process")] for what in ("near", "enough"))
    assert (
        f"within a tenth for {near[0]} of {twin['effects']} ({near[1]}), with nine tenths of the largest gap for "
        f"{enough[0]} ({enough[1]}), in the box for {twin['inside']}."
    ) in page
    ours, alone = kept["diagnosis"], kept["process"]
    assert (
        f"of the true worst for {ours['near']} of {kept['effects']} effects ({alone['near']} for a Gaussian process "
        f"alone), "
        f"and has nine tenths of the largest gap for {ours['enough']} ({alone['enough']}); "
        f"the true worst is in the box that is answered with it for {kept['inside']} ("
    ) in page


def test_what_is_said_of_how_much_could_be_closed():
    page = " ".join(PAGE.read_text().split())
    for name, of in (("emps13", "axis' thirteenth"), ("a1ninth", "A1's ninth")):
        kept = json.loads((RESULTS / f"{name}_reach.json").read_text())
        one = kept["of a material gap, single effects"]
        several = kept["of a material gap, several"]
        true, answer, tuned = (round(100 * one[key]) for key in ("true cause", "answer", "tuned"))
        near = "answer closes nearly as much as the true cause"
        assert (
            f"the {of} set the truth closes {true} % of a single effect's gap (the median of {one['cases']}), the "
            f"answers {answer} % (in {one[near]} nearly as much as the truth), and with a little of everything "
            f"{tuned} "
            "%"
        ) in page
        true, answer, tuned = (round(100 * several[key]) for key in ("true cause", "answer", "tuned"))
        assert (
            f"of several effects' {true}, {answer} ({several[near]} of {several['cases']}) and {tuned} %"
            in page
        )


def test_every_set_was_frozen_before_it_was_opened():
    found = sorted(RESULTS.glob("*_scores.json"))
    assert found
    for path in found:
        kept = json.loads(path.read_text())
        manifest = json.loads((RESULTS / path.name.replace("_scores", "_manifest")).read_text())
        assert kept["frozen"] == manifest["frozen"] <= kept["opened"]
        assert sorted(manifest["answers"]) == sorted(kept["cases"])
        assert re.fullmatch(r"[0-9a-f]{64}", manifest["code"])


def test_what_is_said_of_the_real_go2():
    kept = json.loads((ROOT / "benchmarks" / "real" / "go2_diagnose.json").read_text())
    page = " ".join(PAGE.read_text().split())
    closed, tuned = (100 * kept["how_far"][key]["estimate"] for key in ("share", "tuned_share"))
    *first, last = (name for name in kept["set"] if name not in kept["answer"])
    assert (
        f"*{kept['verdict']}*, {' and '.join(kept['answer'])}, with {', '.join(first)} and {last} not ruled out "
        f"beside them; what is named closes {closed:.0f} % of the held-out gap, and {tuned:.0f} % with a little of "
        f"everything"
    ) in page
    friction, inertia = (
        {k: v["estimate"] for k, v in kept["parameters"][name].items()}
        for name in ("dry_friction", "armature")
    )
    assert (
        f"Of the calves it says {friction['calf']:.2f} N*m of dry friction and "
        f"{inertia['calf']:.3f} kg*m^2 of armature"
    ) in page
    for values in (friction, inertia):
        assert all(0.25 < values[joint] / values["calf"] < 0.5 for joint in ("hip", "thigh"))
    fit = json.loads((ROOT / "benchmarks" / "real" / "go2_fit.json").read_text())
    dry, viscous, armature = fit["of_kinds"].values()
    calves = [force for name, force in fit["of_each_joint"]["dry_friction [N*m]"].items() if "calf" in name]
    for said in (
        f"says {dry['calf']:.2f} N*m and {armature['calf']:.3f} kg*m^2 of the calves",
        f"viscous friction of {min(viscous.values()):.2f} to {max(viscous.values()):.2f} N*m*s/rad as well, "
        f"and closes {100 * fit['of_kinds_closes']:.0f} %",
        f"it closes {100 * fit['of_each_joint_closes']:.0f} %",
        f"four calves differ from {min(calves):.2f} to {max(calves):.2f} N*m",
        f"({kept['given_by_its_model_file']['viscous_friction']['calf']} N*m*s/rad",
    ):
        assert said in page
    for name, values in (("dry_friction", dry), ("armature", armature)):
        for joint, value in values.items():
            assert kept["parameters"][name][joint]["low"] < value < kept["parameters"][name][joint]["high"]


def test_what_is_said_of_simpler_ways():
    kept = json.loads((RESULTS / "emps4_baselines.json").read_text())
    rates = {name: rate["hits"] for name, rate in kept["rates"].items()}
    count = kept["rates"]["ρ only"]["of"]
    joint, single = rates["joint least squares"], rates["single fits"]
    said = (
        f"**Simpler ways.** On the {count} single effects",
        f"joint least-squares fit names {joint}, the best fit of one effect {single}",
        f"the same of ρ alone {rates['ρ only']}, chance {count * kept['chance']:.0f}",
        f"`s2r diagnose`, *none of these* left aside, is the true one in {rates['s2r diagnose, likeliest cause']}",
    )
    page = " ".join(PAGE.read_text().split())
    for words in said:
        assert words in page, words


def test_what_is_said_of_simpler_ways_on_the_a1():
    kept = json.loads((RESULTS / "a1thirteenth_baselines.json").read_text())
    rates = {name: rate["hits"] for name, rate in kept["rates"].items()}
    count = kept["rates"]["ρ only"]["of"]
    assert (
        f"Of the {count} of the A1's thirteenth the same ways name {rates['joint least squares']}, "
        f"{rates['single fits']} and {rates['ρ only']}, chance {count * kept['chance']:.0f}, and `s2r diagnose` "
        f"{rates['s2r diagnose, likeliest cause']}."
    ) in " ".join(PAGE.read_text().split())


def test_what_is_said_of_the_twins():
    kept = json.loads((ROOT / "benchmarks" / "results" / "twins_diagnose.json").read_text())["twins"]
    rows = [line.strip("| ").split(" | ") for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    for place, found in kept.items():
        row = next(row for row in rows if row[0] == f"`{place}`")
        for effect, values in found["parameters"].items():
            for estimate in values.values():
                assert f"{estimate['estimate']:.3g}" in row[2], (place, effect)
        assert len(re.findall(r"\d[\d.]*", row[2])) == sum(len(v) for v in found["parameters"].values())
        for value in (v for values in found["has"].values() for v in values.values()):
            assert re.search(rf"(?<![\d.]){value:g}(?![\d.])|{1000 * value:g} ms", row[1]), (place, value)
        assert row[3] == f"{100 * found['share']['estimate']:.0f} %"
        for effect, values in found["has"].items():  # "all values are within their intervals"
            for name, value in values.items():
                estimate = found["parameters"].get(effect, {}).get(name, {"low": value, "high": value})
                assert estimate["low"] <= value <= estimate["high"], (place, effect)
    assert set(kept) == {"lab", "grass", "sand", "ramp"}


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


def test_what_is_said_of_the_real_axis():
    kept = json.loads((ROOT / "benchmarks" / "real" / "emps_diagnose.json").read_text())
    page = " ".join(PAGE.read_text().split())
    friction = kept["friction"]
    for effect in friction["set"]:
        assert effect in page
    for values in friction["parameters"].values():
        for estimate in values.values():
            assert f"{estimate['estimate']:.3g}" in page
    share, tuned = friction["share"], friction["tuned_share"]
    low, high = 100 * share["low"], 100 * share["high"]
    said = (
        f"closes {100 * share['estimate']:.0f} % [{low:.0f}, {high:.0f}] of the held-out gap, "
        f"{100 * tuned['estimate']:.0f} % with a little of everything"
    )
    assert said in page, said
    assert "may not be there" not in friction["text"]
    offset = next(pair["probability"] for pair in friction["pairs"] if "offset" in pair["effects"])
    assert "offset" not in friction["set"]
    assert f"The offset beside these three has a probability of {offset:.3f}: it is not named." in page
    before, after = friction["control law leaves"]
    assert f"leaves {before:.4f} V of the recorded voltage, and {after:.4f} V with that filter" in page
    least = friction["parameters"]["speed_filter"]["time"]["low"]
    assert f"The interval of its time begins at {least:.6f} s." in page
    assert kept["pulses"]["verdict"] == "none of these"
    left = re.search(
        r"; (\+[\d.]+ V) of controller (between [\d.]+ and [\d.]+ s) is left", kept["pulses"]["text"]
    )
    assert left is not None
    assert f"and when: {left[1]} of it {left[2]} of each move are left" in page
    assert "nothing is left of the motion" in friction["text"]


def test_what_is_said_of_more_than_three_effects():
    page = " ".join(PAGE.read_text().split())
    kept = json.loads((RESULTS / "several.json").read_text())
    five, four = (
        (kept[f"{count} effects, sets up to 6"], kept[f"{count} effects, sets up to 3"]) for count in (5, 4)
    )
    assert five[0]["fitted and not there"] == five[1]["fitted and not there"]
    sure = [sum(one[k]["answers of 0.9 and more"] for one in (five, four)) for k in (0, 1)]
    assert sure[0] == 0
    assert sum(one[1]["of these right"] for one in (five, four)) == 0
    whole = five[0]["all and no other"] + four[0]["all and no other"]
    for words in (
        f"asked of {five[0]['machines'] + four[0]['machines']} machines",
        f"Of five effects {five[0]['of these fitted']} of {five[0]['effects']} are among the fitted ones instead of "
        f"{five[1]['of these fitted']}, and {five[0]['fitted and not there']} that are not there in either case; the "
        f"named ones close {100 * five[0]['closed, median']:.0f} % of the gap instead of "
        f"{100 * five[1]['closed, median']:.0f} %",
        f"Of four effects {four[0]['of these fitted']} of {four[0]['effects']} instead of "
        f"{four[1]['of these fitted']}, "
        f"with {four[0]['fitted and not there']} instead of {four[1]['fitted and not there']} that are not there",
        f"Of {sure[1]} answers of 0.9 and more with sets up to three none was all that is there",
        f"Only {whole} of the {five[0]['machines'] + four[0]['machines']} have all of their effects named",
    ):
        assert words in page, words


def test_what_is_said_of_effects_of_one_kind():
    done = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / "blind" / "kin.py"],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    every, clear = re.findall(r"(\d+ of \d+)", done.stdout.splitlines()[-1])
    page = " ".join(METHOD.read_text().split())
    right_, of = every.split(" of ")
    assert (
        f"there were {of} single delays, lags, masses and motor gains; the true one was likelier than the "
        f"other of its "
        f"kind in {right_}, and where the evidence was clear in {clear} (`python benchmarks/blind/kin.py`)"
    ) in page
