"""A diagnosis in its forms: one answer, and the cart's gap, without a bank or a judge."""

import functools
import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from s2r_spec.diagnose.diagnosis import Diagnosis, NextTest, Verdict, Which
from s2r_spec.diagnose.estimate import Estimate
from s2r_spec.diagnose.gap.body import BodyPart
from s2r_spec.diagnose.how_far import how_far
from s2r_spec.diagnose.isolability import Isolability, Least
from s2r_spec.diagnose.quality import Finding
from s2r_spec.diagnose.quality.doubt import doubted
from s2r_spec.diagnose.remainder import Remainder
from s2r_spec.json_objects.schema import schema
from s2r_spec.report import diagnosed, diagnosed_page
from s2r_spec.report.diagnosed_markdown import markdown
from s2r_spec.report.nextstep import next_step
from tests.errors import states
from tests.report.made import body_of, materiality_of, page_of, spec_of, where_of
from tests.report.test_html import Page

NASTY = '<script>alert("x")</script> & $x$ | `d` 漢字🤖 ' + "long" * 200
EFFECTS = ("friction", "delay", "payload")


LEAST = (
    Least("friction", "force", "N", 0.0, None, 0.4321),
    Least("delay", "time", "s", 0.0, None, None),
    Least("payload", "mass", "kg", 5.0, 4.25, 6.0),
)


@functools.cache
def far_of(dim):
    """Return a gap that friction closes, at the tests of ``where_of``."""
    tests, _ = where_of(dim)
    rng = np.random.default_rng(2)
    real = -0.3 + 0.02 * rng.normal(size=len(tests))
    patched, tuned = (real + scatter * rng.normal(size=len(tests)) for scatter in (0.03, 0.02))
    return how_far(real, np.zeros(len(tests)), patched, tuned, tests, 0.01, 0.02, 3, "m")


def diagnosis(dim, verdict=Verdict.NAMED, body=None, near=8.0, **changes):
    spec = spec_of(dim)
    _, found = where_of(dim)
    found = replace(found, body=body, no_body="" if body else "the backend computes no residuals")
    sigma = np.array([[0, near, 20], [near, 0, 99], [20, 15, 0.0]])
    answer = ("friction",) if verdict in (Verdict.NAMED, Verdict.CONFOUNDED) else ()
    upcoming = dict.fromkeys(spec.space.names, 0.5)
    which = Which(
        none=0.02,
        unknown=0.08,
        singles={"friction": 0.7, "delay": 0.1, "payload": 0.05},
        several={("friction", "delay"): 0.05},
        answer=answer,
        confounded=("friction", "delay") if verdict is Verdict.CONFOUNDED else answer,
        estimates=(Estimate("friction", "force", 1.5, 1.1, 2.2, "N"),) if answer else (),
        nearest_family="actuation",
        isolability=Isolability(EFFECTS, sigma, np.array([9.0, 20.0, 30.0]), 1.0 - np.eye(3), LEAST),
        next_test=NextTest(upcoming | {"gait": 2.0}, "with gait = 2", ("friction", "delay"), 4.0),
    )
    one = Diagnosis(
        verdict=verdict,
        reason="friction explains the data best",
        where=found,
        which=which,
        how_far=far_of(dim),
        materiality=materiality_of(dim),
        patch={"friction": {"force": 1.5}} if answer else {},
        tuned={"friction": {"force": 1.5}, "delay": {"time": 0.0001}},
        provenance={
            "s2r": "0", "seed": 0, "spec_hash": spec.hash, "requirement": "near", "backend": "cart",
            "model_hash": "0" * 64, "rollouts": 20, "held_out": 10, "judge": {"single": 0.9},
        },
        assumptions=("the real rollouts were run as their tests say",),
    )  # fmt: skip
    return replace(one, **changes), spec


def test_gap_margin_and_tolerance_are_in_units_that_a_person_reads_in_every_form():
    found, spec = diagnosis(1)
    facts = "12 µm", "3 %", "400 µm", "0.6 %", "2 mm", "10 tests", "1 of 11", "0 of 60"
    assert states(diagnosed.text(found, spec), *facts)
    assert states(markdown(found, spec), *facts)
    assert states(str(replace(found, spec=spec)._repr_html_()), *facts)
    assert states(page_of(diagnosed_page.render, found, spec).text, *facts)
    shown = diagnosed.record(found, spec)["materiality"]
    assert (shown["matters"], shown["places"], shown["tolerance"]) == (False, [], 0.002)
    assert shown["largest"]["gap"] == pytest.approx(-12e-6, rel=0.01)


LEGS = [f"{leg} {joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]


@pytest.fixture(scope="module")
def one():
    return diagnosis(1, body=body_of(["FR calf", "FR foot", *LEGS[:2], *LEGS[3:], "base"]))


@pytest.fixture(scope="module")
def shown(one):
    return diagnosed_page.render(*one, "twin:lab")


def test_the_page_is_whole_small_offline_and_the_same_again(one, shown):
    text = shown
    assert diagnosed_page.render(*one, "twin:lab") == text
    assert len(text.encode()) < 1_000_000
    page = Page(text)
    assert not page.fetched
    assert "://" not in text.replace("http://www.w3.org/1999/xlink", "")
    assert "#1aa0" not in text
    assert all(page.pictures)
    assert len(page.pictures) == 4


def test_the_answer_comes_first_and_everything_is_there(shown):
    words = Page(shown).text
    assert words.index("NAMED: friction") < 150
    for said in (
        "friction explains the data best",
        "cart against twin:lab, 20 real rollouts, 10 of them held out",
        "What to do next.",
        "vd = 0.5 m/s with gait = 2",
        "4.0 σ",
        "70.0 %",
        "1.5 N 1.1 to 2.2 N",
        "abs(x) <= 0.5",
        "from 0.25 to 0.75 s at FR calf: torque −1.25 N·m",
        "from 0.25 to 0.75 s at FR foot: speed (rms) ±0.2 rad/s",
        "This assumes the real rollouts were run as their tests say",
        "friction.force 0 N 0.432 N or more",
        "delay.time 0 s",
        "payload.mass 5 kg 4.25 kg or less and 6 kg or more",
        "judge: single 0.9",
    ):
        assert said in words, said
    # Whether it matters, where, which, how far.
    titles = ("NAMED: friction", "The gap over the test space", "Which effects ", "How far the gap shrinks")
    places = [words.index(title) for title in titles]
    assert places == sorted(places)


PUSH = Remainder("torque", 1, "FR calf", "", 0.5, 0.6, -3.25, "N*m", "s", 1.8)
QUIET = replace(PUSH, column=2, along="u", low=-np.inf, surplus=0.6)


def test_what_no_effect_leaves_is_said_in_every_form():
    found, spec = diagnosis(1, left=(PUSH, QUIET))
    words = "−3.25 N·m of torque from 0.5 to 0.6 s at FR calf"
    assert diagnosed.text(found, spec).count(words) == 1
    assert words in page_of(diagnosed_page.render, found, spec).text
    assert words in markdown(found, spec)
    assert "where u is below" not in diagnosed.text(found, spec)
    written = json.loads(diagnosed.as_json(found, spec))
    jsonschema.validate(written, schema("s2r/diagnosis/1"))
    assert [each["low"] for each in written["left"]] == [0.5, None]
    still, _ = diagnosis(1, left=(QUIET,))
    silent, _ = diagnosis(1)
    assert len(diagnosed.left_words(still.left)) == 1
    assert diagnosed.left_words(silent.left) == ()


def test_what_no_data_tell_apart_is_said_to_be_so():
    found, spec = diagnosis(0, Verdict.CONFOUNDED)
    assert "friction and delay" in diagnosed.doubt(found.which)
    differs = 1.0 - np.eye(3)
    differs[0, 1] = 0.2  # one way is enough
    differs[1, 2] = 0.1  # payload is not in doubt
    isolable = replace(found.which.isolability, differs=differs)
    assert isolable.kinds(EFFECTS) == (("friction", "delay"), ("delay", "payload"))
    alike = replace(found, which=replace(found.which, isolability=isolable))
    words = diagnosed.doubt(alike.which)
    assert words.count("friction and delay") == 2
    assert "payload" not in words
    assert words in diagnosed.text(alike, spec)
    for shown in (markdown(alike, spec), page_of(diagnosed_page.render, alike, spec).text):
        assert f"{words[1:]}." in shown
    assert diagnosed.doubt(replace(found.which, answer=())) == ""
    beside = replace(found.which, answer=("friction", "delay"), confounded=("friction", "delay", "payload"))
    assert diagnosed.doubt(beside).endswith(" payload")
    only_beside = {"friction": 0.7, "delay": 0.0, "payload": 0.0}
    one = replace(found.which, singles=only_beside, several={("friction", "delay"): 0.2})
    assert diagnosed.doubt(one).endswith(" delay")
    assert "friction" not in diagnosed.doubt(one)


def test_recordings_that_look_misread_are_not_a_success():
    found, spec = diagnosis(0, Verdict.NAMED)
    assert diagnosed.exit_code(found) == 0
    odd = replace(found, findings=(Finding("unit", "u", "u is in mV"),))
    assert diagnosed.exit_code(odd) == 3
    assert diagnosed.record(odd, spec)["exit_code"] == 3
    assert " u " in next_step(odd, spec)


@pytest.mark.parametrize(
    ("same", "verdict", "answer"), [(False, Verdict.UNKNOWN, ()), (True, Verdict.CONFOUNDED, ("friction",))]
)
def test_no_cause_is_named_that_a_mistake_of_the_recordings_explains_as_well(same, verdict, answer):
    found, spec = diagnosis(0, Verdict.NAMED)
    late = Finding("late", "x and y", "x and y come 0.1 s late: by one clock?", "a wrong clock", same)
    odd = doubted(replace(found, findings=(late,), notes=(late.text, "another note"), patch={"friction": {}}))
    assert (odd.verdict, odd.which.answer, diagnosed.exit_code(odd)) == (verdict, answer, 3)
    assert bool(odd.patch) is same
    assert "a wrong clock" in odd.reason
    said = diagnosed.text(odd, spec)
    note, head = said.splitlines()[:2]
    assert late.text in note
    assert head.startswith(verdict.value.upper())
    assert said.count(late.text) == markdown(odd, spec).count(late.text) == 1
    assert page_of(diagnosed_page.render, odd, spec).text.count("by one clock?") == 1
    assert diagnosed.record(odd, spec)["findings"] == [
        {"code": "late", "channel": "x and y", "text": late.text}
    ]


def test_a_mistake_in_one_rollout_takes_no_cause_away():
    found, _ = diagnosis(0, Verdict.NAMED)
    odd = doubted(replace(found, findings=(Finding("spike", "u", "u is off for a sample"),)))
    assert odd.verdict is Verdict.NAMED
    assert diagnosed.exit_code(odd) == 3


def test_confounded_pairs_are_marked():
    page = page_of(diagnosed_page.render, *diagnosis(0, Verdict.CONFOUNDED, near=1.0))
    assert any("less than 3, or of one kind: friction and delay" in alt for alt in page.pictures)
    assert "run the test again with gait = 2" in page.text


@pytest.mark.parametrize(
    ("verdict", "code", "step"),
    [
        (Verdict.NONE, 0, "Diagnose again"),
        (Verdict.SPREAD, 3, "--apply FILE --tuned"),
        (Verdict.NAMED, 0, "--apply FILE, then --sim patched:FILE"),
        (Verdict.CONFOUNDED, 3, "run vd = 0.5 m/s with gait = 2"),
        (Verdict.UNKNOWN, 3, "acts from 0.25 to 0.75 s at wheels (torque)"),
    ],
)
def test_every_verdict_says_what_to_do_next(verdict, code, step):
    found, spec = diagnosis(1, verdict, body=body_of(["wheels", "encoder"]))
    record = json.loads(diagnosed.as_json(found, spec))
    assert step in record["next"]
    assert record["exit_code"] == code
    assert record["next"].endswith(".")
    assert record["next"] in diagnosed.text(found, spec)


def test_the_next_step_says_where_a_range_is_too_narrow_and_where_the_rest_helps():
    found, spec = diagnosis(1, Verdict.UNKNOWN)
    narrow = replace(found.which, estimates=(Estimate("friction", "force", 9.0, 8.0, 9.0, "N", at_end=True),))
    assert "range of friction.force" in next_step(replace(found, which=narrow), spec)
    named, _ = diagnosis(1)
    assert "--tuned" not in next_step(named, spec)
    assert "range of" not in next_step(named, spec)
    ended = replace(named.which, estimates=narrow.estimates)
    assert "range of friction.force" in next_step(replace(named, which=ended), spec)
    better = replace(named.how_far, share=(0.5, 0.4, 0.6), tuned_share=(0.9, 0.8, 1.0))
    assert "--apply FILE --tuned" in next_step(replace(named, how_far=better), spec)
    assert json.loads(diagnosed.as_json(replace(found, which=narrow), spec))["which"]["parameters"][
        "friction"
    ]["force"]["at_end"]


def test_json_is_what_the_schema_says(one):
    derived = schema("s2r/diagnosis/1")
    bare, spec = diagnosis(0, Verdict.UNKNOWN)
    unasked = replace(bare, where=None, how_far=None, which=replace(bare.which, next_test=None))
    for pair in ((unasked, spec), diagnosis(2), diagnosis(0, Verdict.NONE)):
        jsonschema.validate(json.loads(diagnosed.as_json(*pair)), derived)
    whole = json.loads(diagnosed.as_json(*one))
    jsonschema.validate(whole, derived)
    assert whole["where"]["body"]["parts"][0]["shifts"][0]["unit"] == "N*m"
    channels = whole["where"]["trace"]["channels"]
    assert set(channels) == {"x", "u[0]", "u[1]"}
    assert sum(sum(of["delta"]) for of in channels.values()) == pytest.approx(
        whole["where"]["delta"], abs=1e-5
    )
    assert len(whole["how_far"]["tests"]) == 10


@pytest.mark.parametrize(
    "damage",
    [
        lambda one: one.pop("next"),
        lambda one: one.update(verdict="sure"),
        lambda one: one["which"].update(extra=1),
        lambda one: one["where"]["body"]["parts"][0]["shifts"][0].pop("unit"),
        lambda one: one["how_far"]["tests"][0].update(before=None),
    ],
)
def test_the_schema_notices_a_damaged_object(one, damage):
    record = json.loads(diagnosed.as_json(*one))
    damage(record)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(record, schema("s2r/diagnosis/1"))


def test_without_where_or_held_out_tests_the_page_says_so():
    found, spec = diagnosis(0)
    page = page_of(diagnosed_page.render, replace(found, where=None, how_far=None), spec)
    assert "No real rollouts were held out" in page.text
    assert len(page.pictures) == 1


def test_names_are_text_whatever_they_are(one):
    found, spec = one
    shift = replace(found.where.body.parts[0].shifts[0], channel=NASTY, unit="<b>")
    body = replace(found.where.body, parts=(BodyPart(NASTY, (shift,)),))
    odd = replace(
        found,
        reason=NASTY,
        where=replace(found.where, body=body),
        which=replace(
            found.which,
            singles={NASTY: 0.9},
            estimates=(Estimate(NASTY, "<i>", 1.0, 0.5, 2.0, "<u>"),),
            next_test=NextTest({"vd": 0.1}, NASTY, (NASTY, "delay"), 2.0),
        ),
        provenance=found.provenance | {"backend": NASTY},
        assumptions=(NASTY,),
    )
    text = diagnosed_page.render(odd, spec, NASTY)
    assert "<script" not in text
    assert "<b>" not in text.replace('<b style="left', "")
    assert "漢字🤖" in Page(text).text
    assert "<script" not in markdown(odd, spec)


def test_markdown_has_the_answer_tables_and_no_markup_of_others(one):
    shown = markdown(*one)
    assert shown.startswith("### s2r diagnose\n\n**NAMED**: ")
    assert "| friction | 0.700 |" in shown
    assert "| friction.force | 1.5 N | 1.1 to 2.2 N |" in shown
    assert "- from 0.25 to 0.75 s at FR calf: torque −1.25 N·m" in shown
    assert "<summary>This assumes</summary>" in shown


def test_what_the_next_step_says_to_apply_is_there_to_be_applied():
    spread, spec = diagnosis(1, Verdict.SPREAD)
    spread = replace(spread, patch={})
    assert "--apply FILE --tuned" in json.loads(diagnosed.as_json(spread, spec))["next"]
    assert spread.improved(tuned=True) == spread.tuned
    assert spread.improved(tuned=False) == {}
    named, _ = diagnosis(1)
    assert named.improved(tuned=False) == named.patch
    assert named.improved(tuned=True) == named.tuned
    for verdict in (Verdict.NONE, Verdict.UNKNOWN):
        silent = replace(diagnosis(1, verdict)[0], patch={})
        assert silent.improved(tuned=True) == {}
