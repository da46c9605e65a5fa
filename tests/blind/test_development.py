"""Development cases are the same each time, and their scores count sizes, names and probabilities."""

import json
from dataclasses import replace

import pytest

from benchmarks.blind import development
from benchmarks.blind.development import generate
from benchmarks.blind.scoring import Scored, paired, scores
from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.diagnose.simulator.axes import effect_axis


def effect(name):
    """Return an effect whose typical size is 2."""
    return Effect(name, "friction", "", (EffectParameter("x", "N", -4.0, 4.0, 0.0, "normal, 1 N"),))


AXES = {name: (effect_axis(effect(name), effect(name).parameters[0]),) for name in ("drag", "mass", "lag")}


def case(truth, answer, kind="single", verdict="named", p=1.0, **values):
    """Return a case whose background is 0 and whose estimates are true, but for those that are given [N]."""
    background = {name: {"x": 0.0} for name in AXES if name not in truth}
    label = {"kind": kind, "effects": {name: {"x": x} for name, x in truth.items()}, "background": background}
    true = {name: truth.get(name, 0.0) for name in AXES} | values
    singles = dict.fromkeys(AXES, 0.0)
    if len(answer) < 2:
        singles["".join(answer) or "none"] = p
    which = {
        "posterior": {"none": 0.0} | singles,
        "pairs": [{"effects": answer, "probability": p}] if len(answer) > 1 else [],
        "answer": answer,
        "set": answer,
        "parameters": {
            name: {"x": {"estimate": x, "low": x - 0.2, "high": x + 0.2}} for name, x in true.items()
        },
    }
    return Scored("case-000", label, {"verdict": verdict, "which": which, "seconds": 2.0}, AXES)


def test_names_count_by_size_and_by_label():
    small = case({"drag": 0.4}, [], verdict="no material gap")  # 0.2 of typical: either is right
    large = case({"drag": 0.6}, [], verdict="no material gap")  # 0.3 of typical: must be named
    extra = case({"drag": 2.0}, ["drag", "mass"])
    found = scores([small, large, extra])
    assert found["exact, single"] == "0 of 3"
    assert found["right by size, known and healthy"] == "1 of 3"
    assert found["must be named, and are"] == "1 of 2"
    assert found["must not be named, and are not"] == "5 of 6"


def test_sizes_count_in_typical_sizes_with_the_background():
    found = scores([case({"drag": 1.0}, ["drag"], mass=0.3, lag=0.1)])
    assert found["sizes"] == 3
    assert found["size error by effect"] == {"drag": 0.0, "lag": 0.05, "mass": 0.15}
    assert found["in the 90 % interval"] == pytest.approx(2 / 3, abs=1e-4)


def test_the_size_of_an_effect_is_that_of_its_largest_parameter():
    two = Effect(
        "bias", "sensing", "", tuple(EffectParameter(x, "N", -4.0, 4.0, 0.0, "normal, 1 N") for x in "xy")
    )
    label = {"kind": "single", "effects": {"bias": {"x": -0.2, "y": 1.0}}}
    which = {
        "answer": ["bias"], "posterior": {"bias": 1.0}, "pairs": [], "set": ["bias"],
        "parameters": {"bias": {x: {"estimate": 0.0, "low": -0.4, "high": 0.4} for x in "xy"}},
    }  # fmt: skip
    axes = {"bias": tuple(effect_axis(two, one) for one in two.parameters)}
    one = Scored("case-000", label, {"verdict": "named", "which": which}, axes)
    assert one.sizes == {"bias": 0.5}
    assert one.by_size
    assert one.estimates == {"bias.x": (-0.1, 0.0, -0.2, 0.2), "bias.y": (0.5, 0.0, -0.2, 0.2)}


def test_an_unknown_cause_counts_by_the_verdict_and_by_what_is_named():
    seen = case({"gust": 3.0}, [], "unknown", "none of these")
    missed = case({"gust": 3.0}, [], "unknown", "no material gap")
    wrong = case({"gust": 3.0}, ["drag"], "unknown")
    found = scores([seen, missed, wrong])
    assert found["unknown: none of these"] == "1 of 3"
    assert found["unknown: nothing named"] == "2 of 3"
    assert found["log score, known and healthy"] is None


def test_answers_are_compared_case_by_case():
    right, unsure = case({"drag": 2.0}, ["drag"]), case({"drag": 2.0}, [], verdict="no single cause", p=0.5)
    cases = [right, replace(unsure, name="case-001")]
    found = paired(cases, [replace(unsure, name="case-000"), replace(right, name="case-001")])
    assert found["only the first right, by label"] == ["case-000"]
    assert found["only the second right, by label"] == ["case-001"]
    assert found["log score gained, mean"] == pytest.approx(0.0)


def test_a_larger_set_begins_with_the_cases_of_a_smaller_one(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(development, "make_case", lambda module, rng, kind: (kind, rng.integers(10**9)))
    monkeypatch.setattr(development, "write_case", lambda case, name, out, spec: made.append((name, case)))
    assert generate("car", 2, 7, tmp_path) == ["case-000", "case-001"]
    few = list(made)
    made.clear()
    generate("car", 21, 7, tmp_path)
    assert made[:2] == few
    kinds = [kind for _, (kind, _) in made[:20]]
    assert (kinds.count("single"), kinds.count("pair"), kinds.count("unknown")) == (10, 4, 3)


def test_a_case_that_is_there_is_not_made_again(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(development, "make_case", lambda module, rng, kind: kind)
    monkeypatch.setattr(development, "write_case", lambda case, name, out, spec: made.append(name))
    (tmp_path / "sealed").mkdir()
    (tmp_path / "sealed" / "case-000.json").write_text(json.dumps({}))
    generate("car", 2, 7, tmp_path)
    assert made == ["case-001"]
