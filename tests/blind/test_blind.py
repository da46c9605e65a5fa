"""A set is sealed, answered, opened and scored; any change in between is found."""

import json
from dataclasses import replace

import pytest

from benchmarks.blind.protocol import freeze as freezing
from benchmarks.blind.protocol.freeze import BEGUN, freeze
from benchmarks.blind.protocol.score import Rate, load, score
from benchmarks.blind.protocol.seal import seal
from benchmarks.blind.protocol.unseal import unseal
from s2r_spec.errors import UsageError
from tests.errors import naming
from tests.report.test_diagnosed import diagnosis

LABELS = {
    "case-a": {"kind": "single", "effects": {"drag": {"coefficient": 2.0}}},
    "case-b": {"kind": "unknown", "effects": {"gust": {}}, "relative_of": "drag"},
    "case-c": {"kind": "null", "effects": {}},
}


def answered(verdict, first, p=0.95, apart=4.0):
    rest = {"none": 0.0, "unknown": 0.0, "drag": 0.0, "mass": 0.0}
    posterior = rest | {"mass": 1 - p} | {first: p}
    return {
        "verdict": verdict,
        "which": {
            "posterior": posterior,
            "pairs": [],
            "membership": {k: v for k, v in posterior.items() if k not in ("none", "unknown")},
            "set": [first],
            "answer": [first] if verdict == "named" else [],
            "isolability": {"effects": ["drag", "mass"], "sigma": [[0.0, apart], [9.0, 0.0]], "apart": 3.0},
            "parameters": {"drag": {"coefficient": {"estimate": 2.1, "low": 1.8, "high": 2.4, "unit": ""}}},
        },
        "how_far": None,
    }


ANSWERS = {
    "case-a": answered("named", "drag"),
    "case-b": answered("none of these", "unknown"),
    "case-c": answered("named", "mass"),
}


@pytest.fixture
def sealed(tmp_path):
    public, labels = tmp_path / "public", tmp_path / "labels"
    labels.mkdir()
    for name, label in LABELS.items():
        (public / name).mkdir(parents=True)
        (public / name / "rollouts.csv").write_text("id,vd\nr,0.1\n")
        (labels / f"{name}.json").write_text(json.dumps(label))
    assert seal(public, labels, tmp_path / "keys") == 3
    return tmp_path


def frozen(sealed):
    return freeze(sealed / "public", sealed / "answers", lambda case: ANSWERS[case.name])


def test_a_set_is_sealed_frozen_opened_and_scored(sealed):
    assert not list((sealed / "labels").iterdir())
    assert len(frozen(sealed)) == 64
    assert unseal(sealed / "public", sealed / "keys", sealed / "answers") == LABELS
    found = score(load(sealed / "answers"))
    assert found["top-1, single effects"]["hits"] == 1
    assert found["unknown detected, all"]["rate"] == 1.0
    assert found["null called anything else"]["rate"] == 1.0
    assert found["true value in its 90 % interval"]["hits"] == 1
    assert found["right where sure"] | {"low": 0, "high": 0} == {
        "rate": 0.6667, "hits": 2, "of": 3, "low": 0, "high": 0,
    }  # fmt: skip


def test_no_label_is_in_the_public_folder(sealed):
    text = b"".join(p.read_bytes() for p in (sealed / "public").rglob("*") if p.is_file())
    assert b"drag" not in text
    assert b"gust" not in text


@pytest.mark.parametrize(
    ("what", "facts"),
    [
        ("answers/case-a.json", ["case-a", "answer"]),
        ("public/case-a/rollouts.csv", ["case-a", "data"]),
        ("public/case-a.commit", ["case-a", "commitment"]),
    ],
)
def test_a_change_after_freezing_is_found(sealed, what, facts):
    frozen(sealed)
    path = sealed / what
    path.write_text(path.read_text() + " ")
    if path.suffix == ".commit":
        path.write_text("0" * 64)
    with pytest.raises(UsageError, match=naming(*facts)):
        unseal(sealed / "public", sealed / "keys", sealed / "answers")


def test_a_changed_label_does_not_match_its_commitment(sealed):
    frozen(sealed)
    path = sealed / "keys" / "case-a.json"
    path.write_text(path.read_text().replace("drag", "mass"))
    with pytest.raises(UsageError, match=naming("case-a", "label")):
        unseal(sealed / "public", sealed / "keys", sealed / "answers")


def test_answers_are_frozen_and_a_set_is_opened_only_once(sealed):
    frozen(sealed)
    with pytest.raises(UsageError, match=naming(str(sealed / "answers"), "frozen")):
        frozen(sealed)
    unseal(sealed / "public", sealed / "keys", sealed / "answers")
    with pytest.raises(UsageError, match="opened before"):
        unseal(sealed / "public", sealed / "keys", sealed / "answers")


def test_answers_of_two_versions_are_not_frozen_together(sealed, monkeypatch):
    def interrupted(case):
        if case.name == "case-b":
            raise KeyboardInterrupt
        return ANSWERS[case.name]

    with pytest.raises(KeyboardInterrupt):
        freeze(sealed / "public", sealed / "answers", interrupted)
    code = (sealed / "answers" / BEGUN).read_text().strip()
    with monkeypatch.context() as patched:
        patched.setattr(freezing, "code_hash", lambda simulator: "another")
        with pytest.raises(UsageError, match="another version"):
            frozen(sealed)
    with pytest.raises(UsageError, match="another version"):  # or of another simulator
        freeze(
            sealed / "public", sealed / "answers", interrupted, simulator="what its residuals know is other"
        )
    frozen(sealed)
    assert json.loads((sealed / "answers" / "manifest.json").read_text())["code"] == code


def test_answers_of_which_nobody_knows_the_code_are_not_frozen(sealed):
    (sealed / "answers").mkdir()
    (sealed / "answers" / "case-a.json").write_text(json.dumps(ANSWERS["case-a"]))
    with pytest.raises(UsageError, match="code"):
        frozen(sealed)


def test_labels_of_another_set_are_not_written_over(sealed, tmp_path):
    public, labels = tmp_path / "second", tmp_path / "labels"
    (public / "case-a").mkdir(parents=True)
    (public / "case-a" / "rollouts.csv").write_text("id,vd\nr,0.2\n")
    (labels / "case-a.json").write_text(json.dumps(LABELS["case-c"]))
    with pytest.raises(UsageError, match=naming("case-a", "label")):
        seal(public, labels, sealed / "keys")
    assert json.loads((sealed / "keys" / "case-a.json").read_text())["label"] == LABELS["case-a"]
    assert (labels / "case-a.json").exists()


def test_a_set_without_its_labels_is_not_sealed(tmp_path):
    (tmp_path / "public" / "x").mkdir(parents=True)
    (tmp_path / "labels").mkdir()
    with pytest.raises(UsageError, match=naming("x", "label")):
        seal(tmp_path / "public", tmp_path / "labels", tmp_path / "keys")


def test_wilson_interval():
    low, high = Rate(0, 200).interval()
    assert low == 0
    assert high == pytest.approx(0.0188, abs=1e-4)
    assert Rate(0, 0).interval() == (0.0, 1.0)


def far(floor):
    gap = {"mean": 1.0, "low": 0.9, "high": 1.1, "worst": 1.5}
    closed = gap | {"mean": 0.4}
    return {
        "before": gap, "after": closed, "tuned": gap | {"mean": 0.2}, "floor": floor, "material": True,
        "share": {"estimate": 0.6, "low": 0.5, "high": 0.7}, "oracle_share": None,
    }  # fmt: skip


def where(delta, channels, bounds):
    return {
        "delta": delta, "ended": 0.0, "time": [{"delta": delta}], "channels": {"q": channels},
        "switch": {"bounds": bounds},
    }  # fmt: skip


def test_effects_that_move_rho_are_scored_by_themselves():
    label = LABELS["case-a"] | {"moved": 0.5}
    still = LABELS["case-a"] | {"moved": 0.2}
    answer = ANSWERS["case-a"] | {"how_far": far(0.1)}
    found = score([(label, answer), (still, answered("named", "mass") | {"how_far": far(0.1)})])
    assert found["top-1, single effects"]["of"] == 2
    assert found["that moves ρ: first answer right, single"]["hits"] == 1
    assert found["that moves ρ: first answer right, single"]["of"] == 1
    assert found["answered exactly, single"]["hits"] == 1
    shrunk = found["shrink, single"]
    assert shrunk["ratio of sums"] == pytest.approx(0.6 / 0.9, abs=1e-4)
    assert shrunk["ratio of sums, a little of every other effect added"] == pytest.approx(0.8 / 0.9, abs=1e-4)


def test_a_gap_for_which_nothing_was_named_counts_as_not_closed():
    named = ANSWERS["case-a"] | {"how_far": far(0.1)}
    silent = answered("no material gap", "drag") | {"how_far": far(0.1)}
    found = score([(LABELS["case-a"], named), (LABELS["case-a"], silent)])
    assert found["shrink, single"]["cases"] == 2
    assert found["shrink, single"]["ratio of sums"] == pytest.approx(0.5 * 0.6 / 0.9, abs=1e-4)
    assert found["top-1, single effects"]["hits"] == 2
    assert found["answered exactly, single"]["hits"] == 1


def test_whether_something_is_left_of_the_motion_is_scored_for_known_and_unknown_causes():
    label, gap_there = {"kind": "single", "effects": {"mass": {"extra": 1.0}}}, {"how_far": far(0.1)}
    strange = {"kind": "unknown", "effects": {"gust": {"force": 9.0}}}
    named, lost = answered("named", "mass") | gap_there, answered("none of these", "unknown") | gap_there
    told = [
        (label, named | {"left": [{"surplus": 0.4}]}),
        (label, named | {"left": []}),  # of a simulator that cannot say
        (strange, lost | {"left": [{"surplus": 1.7}, {"surplus": 0.2}]}),
        (strange, lost | {"left": [{"surplus": 0.9}]}),
    ]
    found = score(told)
    assert found["something left of the motion, known with a material gap"]["hits"] == 0
    of_unknown = found["something left of the motion, unknown with a material gap"]
    assert (of_unknown["hits"], of_unknown["of"]) == (1, 2)
    assert not any("left of the motion" in name for name in score(told[1:2]))


def test_where_is_scored_by_its_sums_and_bounds():
    right = ANSWERS["case-a"] | {"where": where(-0.3, -0.3, [-0.4, -0.2])}
    wrong = ANSWERS["case-a"] | {"where": where(-0.3, -0.29, [-0.2, -0.1])}
    fell = ANSWERS["case-a"] | {"where": where(-0.7, -0.7, [-0.4, -0.2]) | {"ended": -0.4}}
    assert score([(LABELS["case-a"], fell)])["Δρ within what the two critical predicates allow"]["hits"] == 1
    mixed = ANSWERS["case-a"] | {"where": where(-0.3, -0.3, None)}  # always (a -> b) has no such bounds
    rate = score([(LABELS["case-a"], mixed)])["Δρ within what the two critical predicates allow"]
    assert (rate["hits"], rate["of"]) == (0, 0)  # what claims nothing is no hit
    found = score([(LABELS["case-a"], right), (LABELS["case-a"], wrong)])
    assert found["attribution sums to Δρ, over time and over channels"]["hits"] == 1
    assert found["Δρ within what the two critical predicates allow"]["hits"] == 1


def test_effects_that_are_isolable_are_scored_by_themselves():
    label = LABELS["case-a"]
    cases = [(label, answered("named", "drag")), (label, answered("named", "mass", apart=2.0))]
    found = score(cases)
    assert found["that moves ρ or is isolable: first answer right, single"]["hits"] == 1
    assert found["that moves ρ or is isolable: first answer right, single"]["of"] == 1
    unheard = {"kind": "single", "effects": {"gust": {}}}
    assert "that moves ρ or is isolable: first answer right, single" not in score([(unheard, cases[0][1])])


def test_what_a_diagnosis_answers_can_be_scored():
    found, spec = diagnosis()
    answer = replace(found, spec=spec).to_json()
    label = {"kind": "single", "effects": {"friction": {"force": 1.4}}, "moved": 1.0}
    scores = score([(label, answer), ({"kind": "null", "effects": {}}, answer)])
    assert (scores["cases"], scores["answered exactly, single"]["hits"]) == (2, 1)
    assert scores["true value in its 90 % interval"]["hits"] == 1
    assert scores["null called anything else"]["hits"] == 1


@pytest.mark.parametrize(
    ("least", "of"), [((None, 2.0), 1), ((None, 2.5), 0), ((2.0, None), 1), ((1.0, 3.0), 0)]
)
def test_an_effect_counts_as_isolable_from_the_size_on_that_the_simulator_says(least, of):
    answer = answered("named", "drag")
    below, above = least
    isolable = answer["which"]["isolability"] | {
        "least": [
            {"effect": "drag", "parameter": "coefficient", "unit": "", "nominal": 0.0, "below": below, "above": above},
            {"effect": "mass", "parameter": "extra", "unit": "kg", "nominal": 0.0, "below": None, "above": 0.0},
        ]
    }  # fmt: skip
    answer["which"]["isolability"] = isolable
    found = score([(LABELS["case-a"], answer)])
    words = "that moves ρ or is isolable at its size: first answer right, single"
    assert found.get(words, {"of": 0})["of"] == of
    assert of == 0 or found[words]["hits"] == 1


@pytest.mark.parametrize(("window", "inside"), [([0.1, 0.2], 1), ([0.25, 0.9], 0), ([0.0, 9.0], 1)])
def test_a_windowed_effect_is_scored_by_the_blame_inside_its_window(window, inside):
    label = LABELS["case-b"] | {"where": {"window": window}}
    blamed = where(-0.3, -0.3, [-0.4, -0.2]) | {
        "trace": {"begin": [0.0, 0.1, 0.2, 0.3], "channels": {"q": {"delta": [0.0, -0.9, 0.1, 0.0]}}}
    }
    found = score([(label, ANSWERS["case-b"] | {"where": blamed}), (label, ANSWERS["case-b"])])
    rate = found["at least 80% of Δρ in the window in which the effect acts"]
    assert (rate["hits"], rate["of"]) == (inside, 1)


def test_a_null_for_which_nothing_single_was_named_is_right():
    null = LABELS["case-c"]
    found = score([(null, answered("no single cause", "none")), (null, answered("none of these", "unknown"))])
    assert found["null called anything else"]["hits"] == 1


def closed_world(verdict, sets, **more):
    """Return an answer of today's schema: sets of effects with probabilities, and no probability of another cause."""
    singles = {name: sets.get((name,), 0.0) for name in ("drag", "mass")}
    answer = answered(verdict, "drag")
    which = answer["which"] | {
        "posterior": {"none": sets.get((), 0.0), **singles},
        "pairs": [{"effects": list(names), "probability": p} for names, p in sets.items() if len(names) > 1],
        "membership": {"drag": 0.9, "mass": 0.1},
    }
    which.pop("isolability")
    which["parameters"] = which["parameters"] | {
        "mass": {"extra": {"estimate": 0.0, "low": -0.1, "high": 0.1, "unit": "kg"}}
    }
    return answer | {"which": which} | more


def test_a_cause_outside_the_catalogue_counts_by_its_verdict_alone():
    right = closed_world("none of these", {("drag",): 0.99})
    named = closed_world("named", {("drag",): 0.99})
    found = score([(LABELS["case-b"], right), (LABELS["case-b"], named), (LABELS["case-a"], named)])
    assert found["unknown detected, all"]["hits"] == 1
    assert found["right where sure"] | {"low": 0, "high": 0, "rate": 0} == {
        "rate": 0, "hits": 1, "of": 2, "low": 0, "high": 0,
    }  # fmt: skip
    assert found["log score"] == pytest.approx(0.01, abs=1e-3)


def test_background_counts_in_the_coverage_of_intervals():
    label = LABELS["case-a"] | {"background": {"mass": {"extra": 0.2}}}
    found = score([(label, closed_world("named", {("drag",): 0.99}))])
    assert found["true value in its 90 % interval"]["of"] == 1
    every = found["true value in its 90 % interval, background included"]
    assert (every["hits"], every["of"]) == (1, 2)


def test_a_gap_without_an_oracle_has_its_closed_part():
    gap = {key: value for key, value in far(0.1).items() if key != "oracle_share"}
    found = score([(LABELS["case-a"], closed_world("named", {("drag",): 0.99}, how_far=gap))])
    assert found["shrink, single"]["ratio of sums"] == pytest.approx(0.6 / 0.9, abs=1e-4)
    assert found["shrink, single"]["mean share of oracle"] is None
