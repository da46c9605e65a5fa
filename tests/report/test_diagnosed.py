"""The answer of a diagnosis in its forms: every effect, and the cart's gap, without a simulation."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from s2r_spec.base.json_values import document
from s2r_spec.diagnose.decision import Evidence, Rule, Verdict
from s2r_spec.diagnose.diagnosis import Diagnosis, Which
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, Power, Separation
from s2r_spec.diagnose.experiment_design.next_test import NextTest
from s2r_spec.diagnose.gap.held_out import ClosedThere, compare
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest, materiality
from s2r_spec.diagnose.gap.shares import Share
from s2r_spec.diagnose.inference.estimates import EffectEstimate, ParameterEstimate
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.residuals.left import Remainder
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.report import diagnosis as diagnosis_report
from s2r_spec.report import diagnosis_page
from s2r_spec.report.advice import next_step
from s2r_spec.report.diagnosis import describe, markdown
from s2r_spec.report.figures.robot import is_quadruped, robot
from s2r_spec.report.gap_words import gap_and_limit_words
from s2r_spec.report.records.schema import schema
from tests.diagnose.test_decision import CLOCK, FELL, MATTERS, SAME, UNEXPLAINED
from tests.errors import states
from tests.report.made import body_of, materiality_of, page_of, spec_of, where_of
from tests.report.test_html import Page

CHIRP = Candidate(Experiment("chirp", (("gain", 2.0),)), 1.0)
COAST = Candidate(Experiment("coast"), 1.0, allowed=False)
NASTY = '<script>alert("x")</script> & $x$ | `d` 漢字🤖 ' + "long" * 200


def effect(name, parameter, unit, probability, value, half, width=0.1, at_end=False):
    ends = value, value - half, value + half
    size = ParameterEstimate(parameter, unit, *ends, *(end / 2 for end in ends), width, at_end)
    return EffectEstimate(name, "actuation", probability, probability, (size,))


FRICTION = effect("friction", "force", "N", 0.999, 1.5, 0.2)
DELAY = effect("delay", "time", "s", 0.3, 0.004, 0.003, width=0.4)
PAYLOAD = effect("payload", "mass", "kg", 0.01, 0.1, 0.2)
EFFECTS = (PAYLOAD, FRICTION, DELAY)


SETTLED = Separation(
    "delay",
    ("friction", "delay"),
    ("friction",),
    (Power(CHIRP, 4.1, True), Power(COAST, 3.2, True)),
)
MISSING = replace(SETTLED, powers=(Power(COAST, 3.2, True), Power(CHIRP, 1.0, False)))
NEVER = replace(SETTLED, powers=(Power(CHIRP, 1.0, False),))
NEXT = NextTest(CHIRP, (("friction", "delay"), ("friction",)), 4.1)


def far_of(dim, closed=0.95, size=0.3):
    tests, _ = where_of(dim)
    rng = np.random.default_rng(2)
    real = -size + 0.02 * rng.normal(size=len(tests))
    left = [closed * real + scatter * rng.normal(size=len(tests)) for scatter in (0.01, 0.01)]
    return compare(real, [np.zeros(len(tests)), *left], tests, 0.01, 0.02, "m")


def diagnosis(dim=0, effects=EFFECTS, separation=SETTLED, test=NEXT, passive=False, **more):
    spec, (_, place) = spec_of(dim), where_of(dim)
    known = {"held_out": far_of(dim), "materiality": materiality_of(dim)}
    known["separations"] = (separation,) if separation else ()
    evidence = Evidence(effects, **(known | more))
    sets = ((("friction",), 0.7), (("friction", "delay"), 0.3))
    provenance = {
        "s2r": "0", "seed": 0, "spec_hash": spec.hash, "requirement": "near", "backend": "cart",
        "model_hash": "0" * 64, "rollouts": 20, "held_out": 10,
    }  # fmt: skip
    tuned = {"friction": {"force": 1.5}, "delay": {"time": 0.001}}
    assumed = ("the real rollouts were run as their tests say",)
    which = Which(evidence, sets, test)
    return Diagnosis(which, place, tuned, provenance, assumed, passive=passive, spec=spec), spec


def test_the_first_screen_has_the_answer_in_order():
    found, spec = diagnosis()
    said = diagnosis_report.text(found, spec)
    order = (
        "CONFOUNDED", "friction explains the data best", "delay may be there, too", "largest gap", "12 µm",
        "friction.force", "1.50 ± 0.20 N", "0.75 ± 0.10", "possible", "\n  delay ", "4.0 ± 3.0 ms", "probability 0.30",
        "chirp gain = 2 would settle it (4.1 σ per run)", "ruled out: payload", "before", "closed", "where:",
        "next: To settle what is open, run chirp gain = 2", "10 of them held out",
    )  # fmt: skip
    assert [words for words in order if words not in said] == []
    places = [said.index(words) for words in order]
    assert places == sorted(places)
    assert "payload.mass" not in said


def test_every_size_is_in_markdown_page_and_json():
    found, spec = diagnosis()
    page = page_of(diagnosis_page.render, found, spec).text
    for name in ("friction.force", "delay.time", "payload.mass"):
        assert name in page
        assert f"| {name} |" in markdown(found, spec)
    sizes = found.to_json()["which"]["parameters"]
    assert sizes["payload"]["mass"]["size"] == 0.05
    assert found.to_json()["which"]["status"] == {
        "payload": "ruled out", "friction": "named", "delay": "possible",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("separation", "words"),
    [
        (SETTLED, "chirp gain = 2 would settle it (4.1 σ per run)"),
        (
            MISSING,
            "no allowed experiment would settle it; coast, which is not allowed, would (3.2 σ per run)",
        ),
        (NEVER, "no experiment would settle it"),
        (replace(NEVER, excluded=("payload",)), "no experiment would tell it from payload"),
    ],
)
def test_a_possible_effect_comes_with_the_experiment_that_settles_it_or_the_one_that_is_missing(
    separation, words
):
    found, spec = diagnosis(separation=separation)
    for said in (
        diagnosis_report.text(found, spec),
        markdown(found, spec),
        page_of(diagnosis_page.render, found, spec).text,
    ):
        assert words in said


def test_a_test_is_told_in_the_units_of_the_specification():
    """The simulator has km/h, and the specification m/s."""
    own = Candidate(Experiment.test({"speed": 1.8}), 1.0, test={"vd": 0.5})
    found, spec = diagnosis(
        1, separation=replace(SETTLED, powers=(Power(own, 4.0, True),)), test=replace(NEXT, candidate=own)
    )
    assert "run vd = 0.5 m/s, which separates" in next_step(found, spec)
    assert "vd = 0.5 m/s would settle it" in diagnosis_report.text(found, spec)
    which = found.to_json()["which"]
    assert which["next_test"]["params"] == {"vd": 0.5}
    assert which["separations"][0]["powers"][0]["experiment"] == "vd = 0.5"


def test_an_effect_that_the_data_do_not_show_is_not_said_to_be_ruled_out():
    slip = effect("slip", "factor", "", 0.03, 0.02, 0.1, width=0.9)
    found, spec = diagnosis(effects=(*EFFECTS, slip))
    said = diagnosis_report.text(found, spec)
    assert "not visible in these data: slip" in said
    assert "ruled out: payload\n" in said
    assert found.to_json()["which"]["hidden"] == ["delay", "slip"]


def test_logs_of_tests_alone_say_first_what_they_cannot_tell():
    found, spec = diagnosis(passive=True)
    second = diagnosis_report.text(found, spec).splitlines()[1]
    assert "delay" in second
    assert "friction" not in second
    assert "tests of the specification alone" not in diagnosis_report.text(*diagnosis())
    assert "Tests of the specification alone" in page_of(diagnosis_page.render, found, spec).text


PUSH = Remainder("torque", 1, "FR calf", "", 0.5, 0.6, -3.25, "N*m", "s", 1.8)


SURE = {"effects": (FRICTION, PAYLOAD), "separation": None}
NONE = {"effects": (PAYLOAD,), "separation": None, "test": None}
EITHER = {"effects": (DELAY,), "further": ("delay",)}
SMALL = {"held_out": far_of(0, size=0.012)}
FALLS = {"held_out": None, "materiality": FELL}
ODD = {"held_out": far_of(0, 0.6), "misfit": UNEXPLAINED}
SPIKE = Finding("spike", "u", "u is off")


@pytest.mark.parametrize(
    ("more", "rule", "code", "reason", "step"),
    [
        (SURE, Rule.EFFECT, 0, "closes 9", "--apply FILE, then --sim patched"),
        ({}, Rule.OPEN, 3, "delay may be there", "run chirp"),
        (EITHER, Rule.EITHER, 3, "do not settle it: delay", "run chirp"),
        (
            EITHER | {"test": None, "separation": NEVER},
            Rule.EITHER,
            3,
            "do not settle it",
            "Measure delay directly",
        ),
        (
            EITHER | {"test": None, "separation": MISSING},
            Rule.EITHER,
            3,
            "do not settle it",
            "Allow coast, or measure delay",
        ),
        (NONE, Rule.SPREAD, 3, "No cause stands out", "--apply FILE --tuned"),
        (
            SURE | {"left": (PUSH,), "held_out": far_of(0, 0.7)},
            Rule.REMAINDER,
            3,
            "Unexplained: −3.25 N·m",
            "explains −3.25",
        ),
        (
            SURE | {"left": (PUSH,)},
            Rule.EFFECT,
            0,
            "No effect explains −3.25 N·m",
            "--apply FILE, then --sim patched",
        ),
        (
            {"held_out": far_of(0, 0.2)},
            Rule.STAYS,
            3,
            "nearest is friction",
            "outside the catalogue",
        ),
        (
            ODD,
            Rule.LEFT,
            3,
            "leaves 26 %",
            "outside the catalogue",
        ),
        (SURE | SMALL, Rule.EFFECT, 0, "The gap in ρ is not material", "leave the simulator as it is"),
        (NONE | SMALL, Rule.NONE, 0, "The traces do differ, most as with friction", "Diagnose again"),
        (NONE | FALLS, Rule.SPREAD, 3, "4 of 10 real rollouts ended early", "Leave the simulator"),
        (FALLS | {"materiality": MATTERS}, Rule.OPEN, 3, "No rollout was held out", "run chirp"),
        (
            {"findings": (CLOCK,)},
            Rule.MISTAKE,
            3,
            "would do the same and explains",
            "First check x",
        ),
        ({"findings": (SAME,)}, Rule.ALIKE, 3, "a wrong clock would do the same", "First check x"),
        (SURE | {"findings": (SPIKE,)}, Rule.EFFECT, 3, "friction explains", "First check u"),
    ],
)
def test_every_rule_has_a_reason_an_exit_code_and_a_next_step(more, rule, code, reason, step):
    found, spec = diagnosis(**more)
    record = json.loads(document(found))
    jsonschema.validate(record, schema("s2r/diagnosis/2"))
    assert found.rule is rule
    assert reason in record["reason"]
    assert step in record["next"]
    assert record["exit_code"] == code
    said = diagnosis_report.text(found, spec)
    assert record["reason"] in said
    assert record["next"] in said
    assert bool(record["patch"]) is bool(found.which.answer)


def test_what_is_applied_is_the_named_effects_and_with_tuned_a_little_of_all():
    found, _ = diagnosis()
    assert found.improved(tuned=False) == found.patch == {"friction": {"force": 1.5}}
    assert found.improved(tuned=True) == found.tuned
    spread, _ = diagnosis(effects=(DELAY,))
    assert spread.improved(tuned=False) == {}
    assert spread.improved(tuned=True) == spread.tuned
    nothing, _ = diagnosis(**NONE | SMALL)
    assert nothing.improved(tuned=True) == {}


def test_the_next_step_says_where_a_range_is_too_narrow_and_where_the_rest_helps():
    ended = effect("friction", "force", "N", 0.999, 1.5, 0.2, at_end=True)
    found, spec = diagnosis(effects=(ended,), separation=None)
    assert "range of friction.force" in next_step(found, spec)
    assert "friction.force is at the end of its range" in found.reason
    better = replace(far_of(0), share=Share(0.5, 0.4, 0.6), tuned_share=Share(0.9, 0.8, 1.0))
    assert "--apply FILE --tuned" in next_step(diagnosis(**SURE, held_out=better)[0], spec)


def test_membership_and_ranking_are_those_of_before():
    found, _ = diagnosis()
    assert list(found.which.membership) == ["friction", "delay", "payload"]
    assert found.which.ranked[0] == (("friction",), 0.7)
    assert found.which.nearest_family == "actuation"


def test_the_schema_notices_a_damaged_object():
    record = json.loads(document(diagnosis()[0]))
    jsonschema.validate(record, schema("s2r/diagnosis/2"))
    for damage in (
        lambda one: one.pop("next"),
        lambda one: one["which"].update(extra=1),
        lambda one: one["which"]["parameters"]["delay"]["time"].pop("size"),
        lambda one: one["how_far"]["tests"][0].update(before=None),
    ):
        damaged = json.loads(json.dumps(record))
        damage(damaged)
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(damaged, schema("s2r/diagnosis/2"))


def test_the_forms_of_a_result_in_python(tmp_path):
    plain, spec = diagnosis()
    one = replace(plain, spec=spec, real="twin:lab")
    assert one.to_json() == plain.to_json()
    assert one.save(tmp_path / "kept").read_text() == document(plain) + "\n"
    assert one.report(tmp_path / "x.html").read_text() == diagnosis_page.render(plain, spec, "twin:lab")
    assert repr(one).startswith("Diagnosis(confounded: On average over the held-out tests")
    assert "friction.force" in one._repr_html_()
    assert "This assumes" in plain._repr_html_()


def test_the_page_is_whole_small_and_offline():
    found, spec = diagnosis(2)
    found = replace(
        found, where=replace(found.where, body=body_of(["FR calf", "FR foot", "base"]), no_body=None)
    )
    text = diagnosis_page.render(found, spec, "twin:lab")
    assert diagnosis_page.render(found, spec, "twin:lab") == text
    assert len(text.encode()) < 1_000_000
    page = Page(text)
    assert not page.fetched
    titles = (
        "CONFOUNDED: friction",
        "The gap over the test space",
        "Which effects",
        "How far the gap shrinks",
    )
    places = [page.text.index(title) for title in titles]
    assert places == sorted(places)
    assert all(page.pictures)


def test_names_of_users_do_not_break_a_form():
    nasty = effect(NASTY, "p", "N", 0.999, 1.5, 0.2)
    found, spec = diagnosis(effects=(nasty,), separation=None)
    assert "<script>" not in diagnosis_page.render(found, spec)
    assert all(line.count("| ") < 20 for line in markdown(found, spec).splitlines())
    assert NASTY.split(" ")[0] in diagnosis_report.text(found, spec)


@pytest.mark.parametrize(
    ("dim", "starts"),
    [(0, ["|Δρ| of 1 held-out"]), (2, ["Map of the expected Δρ over vd and load", "|Δρ| of 10 held-out"]),
     (3, ["Δρ along vd, load, slope", "|Δρ| of 10 held-out"])],
)  # fmt: skip
def test_the_gap_is_drawn_over_any_test_space(dim, starts):
    page = Page(diagnosis_page.render(*diagnosis(dim)))
    for start in starts:
        assert sum(alt.startswith(start) for alt in page.pictures) == 1
    assert page.pictures[-1].startswith(starts[-1])


def test_over_one_parameter_held_out_tests_stand_on_the_curve():
    page = Page(diagnosis_page.render(*diagnosis(1)))
    assert states(page.pictures[0], "Δρ", "vd", "0", "1 m/s", "10 held-out tests")
    assert states(page.text, "before", "after")


def test_four_legs_are_drawn_and_any_other_machine_is_rows():
    legs = [f"{leg} {joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]
    whole = body_of(["FR calf", "FR foot", *legs[:2], *legs[3:], "base"])
    assert is_quadruped(whole)
    assert robot(whole, "robot").svg.count(">thigh<") == 4
    other = body_of(["wheels", "encoder"])
    assert not is_quadruped(other)
    picture = robot(other, "rows")
    assert ">trunk<" not in picture.svg
    assert ">wheels<" in picture.svg
    assert picture.alt.startswith("2 of 2 parts")


def test_without_where_or_held_out_tests_the_page_says_so():
    found, spec = diagnosis(held_out=None)
    page = page_of(diagnosis_page.render, replace(found, where=None), spec)
    assert "No real rollouts were held out" in page.text
    assert page.pictures == []


def shares_there(patched, tuned):
    there = ClosedThere(
        2, *(None if part is None else Share(part, part - 0.1, part + 0.1) for part in (patched, tuned))
    )
    return {"held_out": replace(far_of(0, size=0.012), closed_there=there), "materiality": MATTERS}


def test_small_amounts_of_all_effects_are_advised_only_where_they_surely_close_some_of_the_gap():
    for shares, advised in ((0.9, True), (0.3, True), (0.05, False), (-0.5, False), (None, False)):
        found, spec = diagnosis(**NONE | shares_there(None, shares))
        assert found.rule is Rule.SPREAD
        assert ("--tuned" in next_step(found, spec)) is advised


def test_a_gap_of_single_tests_is_closed_there_and_said_so():
    found, _ = diagnosis(**SURE | shares_there(0.9, None))
    assert found.rule is Rule.EFFECT
    assert "90 %" in found.reason
    assert "held-out gap" not in found.reason


def test_what_is_named_is_not_among_what_tests_alone_cannot_measure():
    friction = effect("friction", "force", "N", 0.999, 1.5, 0.2, width=0.9)
    ruled_out = replace(
        PAYLOAD, parameters=(*PAYLOAD.parameters, replace(DELAY.parameters[0], dependent=True))
    )
    found, spec = diagnosis(effects=(friction, ruled_out, DELAY), passive=True)
    assert found.which.status["friction"].value == "named"
    said = describe(found, spec).passive
    assert states(said, "delay")
    assert not states(said, "friction")
    assert not states(said, "payload")
    assert describe(*diagnosis(effects=(friction,), separation=None, passive=True)).passive == ""


@pytest.mark.parametrize(("probability", "named"), [(0.04, False), (0.45, False), (0.55, True)])
def test_the_nearest_effect_is_one_that_is_more_likely_than_all_others(probability, named):
    found, _ = diagnosis(**NONE | {"held_out": far_of(0, 0.2), "misfit": UNEXPLAINED})
    sets = (((), 0.4 * (1.0 - probability)), (("payload",), probability))
    found = replace(found, which=replace(found.which, sets=sets))
    assert found.verdict is Verdict.UNKNOWN
    assert states(found.reason, "payload") is named
    assert bool(found.which.nearest_family) is named


@pytest.mark.parametrize("surplus", [0.6, 1.8])
def test_none_of_these_says_where_most_of_the_motion_is_left(surplus):
    found, spec = diagnosis(left=(replace(PUSH, surplus=surplus),), held_out=far_of(0, 0.2))
    assert found.verdict is Verdict.UNKNOWN
    assert states(found.reason, "−3.25 N·m", "torque", "0.5", "0.6 s", "FR calf")
    for line in describe(found, spec).parts[-1:]:
        assert states(line, "−3.25 N·m", "0.5", "0.6 s", "FR calf")
    assert states(next_step(found, spec), "−3.25 N·m", "0.5", "0.6 s", "FR calf")


def test_a_material_gap_is_an_average_and_a_gap_matters_at_tests():
    quiet = materiality([RolloutsAtTest({"vd": 0.5}, np.array([1.0]), np.linspace(0.9, 1.1, 6))], "m")
    found, spec = diagnosis(materiality=quiet)
    assert found.how_far.material
    assert states(found.reason, "average", "held-out", "0.30 m")
    assert "matter" not in found.reason
    (_, tests) = describe(found, spec).matters
    assert states(tests, "none", "1")
    close = replace(far_of(0), background=0.29)
    mean, most = gap_and_limit_words(close)
    assert close.material
    assert mean != most


def test_a_patch_that_makes_the_gap_larger_does_not_close_none_of_it():
    for share, words in (
        (Share(-1.5, -3.0, -0.6), "surely makes"),
        (Share(-0.5, -1.5, 0.2), "does not make"),
    ):
        far = replace(far_of(0, 0.2), share=share)
        reason = diagnosis(**SURE | {"held_out": far, "misfit": UNEXPLAINED})[0].reason
        assert words in reason
        assert "close" not in reason
