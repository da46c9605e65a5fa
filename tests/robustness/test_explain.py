"""An explanation gives ρ back, and names everything the verdict rests on."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from s2r_spec.errors import TraceError
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.responsible import responsible_samples
from s2r_spec.robustness.sampled import walk_samples
from s2r_spec.robustness.ticks import clock_of
from s2r_spec.spec import load_spec, parse_spec
from s2r_spec.trace import Trace
from tests.errors import naming, states
from tests.examples import examples
from tests.robustness.definitions import NoSampleError, Truth, by_definition, too_short
from tests.robustness.drawing import Case, cases, formulas, text_of

A1 = Path(__file__).parents[2] / "specs" / "a1_velocity.stl"
MARGIN = {
    "<": lambda left, right: right - left,
    ">": lambda left, right: left - right,
    "=": lambda left, right: -abs(left - right),
    "!": lambda left, right: abs(left - right),
}


@settings(max_examples=examples(300), deadline=None)
@given(case=st.one_of(cases("regular"), cases("irregular")))
def test_the_predicate_at_its_instant_gives_rho_back(case: Case) -> None:
    assume(not too_short(case))
    case = Case(**(vars(case) | {"end": "clip"}))
    try:
        rho, true = by_definition(case)[0], by_definition(case, Truth)[0]
    except NoSampleError:
        assume(False)
    times = case.start + np.array(case.ticks) * float(case.period)
    trace = Trace(times, {"x": case.x, "y": case.y})
    spec = parse_spec(case.text)
    found = spec.explain(trace, "it", {"p": case.param}, until=case.until, partial=True)
    assert found.rho == pytest.approx(rho, abs=1e-9)
    assert found.satisfied == true
    json.dumps(found.to_json())
    if found.reason:
        assert math.isinf(rho)
        return
    left, right = (side.value for side in found.sides)
    operator = next(sign for sign in ("!", "=", "<", ">") if f" {sign}" in found.predicate)
    if any(f" {sign}=" in found.predicate for sign in "<>"):
        operator = "<" if " <=" in found.predicate else ">"
    assert found.margin == pytest.approx(MARGIN[operator](left, right))
    assert found.factor * found.margin == pytest.approx(rho)
    # and the predicate by itself, at that instant, has this margin
    alone = parse_spec(f"signal x signal y param p in [-9, 9] require it: {found.predicate}")
    at = int(np.argmin(np.abs(times - found.instant)))
    assert alone.robustness_signal(trace, "it", {"p": case.param})[at] == pytest.approx(found.margin)
    for part in found.parts:
        assert abs(part.rho) == pytest.approx(abs(rho))
    assert any(start <= found.instant <= end for start, end in found.responsible)
    # a predicate that decides is true where the requirement is, or false below a negation
    held = alone.evaluate(trace, "it", {"p": case.param}, sparse=True).truth[at]
    assert held == (found.satisfied == (found.factor > 0))


PREDICATES = st.integers(0, 2).map(lambda k: (">=", ("name", f"z{k}"), ("num", 0.0)))


@settings(max_examples=examples(300), deadline=None)
@given(
    formula=formulas(PREDICATES, ["not", "next", "prev", "rise", "fall"]),
    data=st.data(),
    gaps=st.lists(st.integers(1, 2), max_size=8),
    until=st.sampled_from(["open", "closed"]),
)
def test_what_is_not_responsible_may_be_anything(formula, data, gaps, until) -> None:
    n = len(gaps) + 1
    sample = st.lists(st.sampled_from([-2.0, -1.0, 1.0, 2.0]), min_size=n, max_size=n).map(np.array)
    signals = {f"z{k}": data.draw(sample)[np.newaxis] for k in range(3)}
    others = {name: data.draw(sample) for name in signals}
    clock = clock_of(np.cumsum([0.0, *gaps]))
    spec = parse_spec(f"signal z0 signal z1 signal z2 require it: {text_of(formula, 1)}").formulas["it"]

    def walk(chosen: dict) -> Walk:
        return walk_samples(SampledSignals(clock, chosen, {}, until))

    try:
        before = walk(signals)
        rho = np.broadcast_to(before(spec), n)[0]
        at = responsible_samples(spec, before, clock)
    except TraceError:
        assume(False)
    needed = {name: np.zeros(n, dtype=bool) for name in signals}
    for node in _predicates(spec):
        if id(node) in at:
            needed[node.left.name] |= at[id(node)]
    changed = {name: np.where(needed[name], signals[name], others[name][np.newaxis]) for name in signals}
    assert (np.broadcast_to(walk(changed)(spec), n)[0] >= 0) == (rho >= 0)


def _predicates(formula):
    from s2r_spec.lang import formula as f

    return [node for node in f.walk(formula) if isinstance(node, f.Comparison)]


TIMES = np.arange(16) / 10


def test_the_a1_in_words() -> None:
    vx = np.full(16, 0.3)
    vx[2:4] = 0.36, 0.34
    found = load_spec(A1).explain(Trace(TIMES, {"vx": vx}, {"vx": "m/s"}), "walking", {"vd": 0.3})
    head, decided, there, span = str(found).splitlines()
    assert states(head, "walking violated", "ρ = -0.03 m/s")
    assert states(decided, "t = 0.2 s", "`overshoot(vx, vd) <= tol_o`", "line 13", "`rises`", "-0.03 m/s")
    assert states(there, "vx = 0.36 m/s", "vd = 0.3 m/s")
    assert states(span, "0.2 s", "0.3 s")
    assert [part.text for part in found.parts] == [
        "rises and settles", "rises", "always[0, 0.5 s] (overshoot(vx, vd) <= tol_o)",
        "overshoot(vx, vd) <= tol_o",
    ]  # fmt: skip
    good = load_spec(A1).explain(Trace(TIMES, {"vx": np.full(16, 0.31)}), "walking", {"vd": 0.3})
    assert states(str(good).splitlines()[-1], "0 s", "0.5 s")


def test_margins_of_several_units_and_below_a_negation() -> None:
    spec = parse_spec(
        "signal v {m/s} signal u[2] {V} param w {km/h} = 7.2\n"
        "require it: not eventually (v >= w or u[0] >= 1 {mV}) and always (norm(u) <= 5)"
    )
    trace = Trace([0, 1, 2], {"v": [0, 3, 0], "u": [[-3, 0], [-3, -3], [-3, 0]]})
    found = spec.explain(trace, "it")
    assert (found.rho, found.unit, found.factor) == (pytest.approx(-1), "mixed", -1)
    assert (found.instant, found.predicate, found.margin_unit) == (1, "v >= w", "m/s")
    assert [str(signal) for signal in found.signals] == ["v = 3 m/s", "w = 7.2 km/h"]
    assert found.responsible == ((1, 1),)
    far = Trace([0, 1], {"v": [0, 0], "u": [[-3, 4], [-30, 40]]})
    assert [str(signal) for signal in spec.explain(far, "it").signals] == ["u[0] = -30 V", "u[1] = 40 V"]


def test_rho_without_a_predicate() -> None:
    spec = parse_spec("signal x\nrequire late: eventually[5, 6] x > 0\nrequire never: always false", "a.stl")
    trace = Trace([0, 1, 2], {"x": [1, 2, 3]})
    late, never = spec.explain(trace, "late", partial=True), spec.explain(trace, "never")
    at = "ρ = -inf", "t = 0 s"
    assert states(str(late), "late violated", *at, "`eventually[5, 6] x > 0`", "line 2")
    assert states(str(never), "never violated", *at, "`false`", "line 3")
    with pytest.raises(TraceError, match=naming("'late'", "6 s", "2 s")):
        spec.explain(trace, "late")


def test_a_fall_is_explained_by_itself() -> None:
    fallen = Trace([0.0], {"vx": [0.1]}, meta={"failure": "fall"})
    said = str(load_spec(A1).explain(fallen, "walking", {"vd": 0.3}))
    assert states(said, "walking violated", "ρ = -0.5 m/s", "'fall'", "certify")


@pytest.mark.parametrize(
    ("condition", "true"),
    [("x == 1", True), ("x != 1", False), ("x <= 1", True), ("x < 1", False), ("not x == 1", False),
     ("not x < 1", True), ("x == 1 -> x < 1", False), ("x > 1 or x >= 1", True), ("x <= 1 and x < 1", False),
     ("x < 1 <-> x > 1", True), ("if(x < 1, 1, 0) >= 1", False), ("count(x != 1) >= 1", False)],
)  # fmt: skip
def test_at_zero_the_comparisons_decide(condition: str, true: bool) -> None:
    spec = parse_spec(f"signal x {{kg}} require it: {condition}")
    trace = Trace([0, 1], {"x": [1, 1]})
    found = spec.explain(trace, "it")
    assert found.satisfied == true
    assert states(str(found), f"it {'holds' if true else 'violated'}", "ρ = ")
    assert spec.satisfied(trace) == {"it": true}
    monitor = spec.monitor()
    monitor.update(0, {"x": 1})
    assert monitor.finish()["it"].satisfied == true
    if "if" not in condition and "count" not in condition:
        assert found.rho == spec.robustness(trace)["it"] == 0
    for interpolation in ("hold", "linear"):
        assert spec.evaluate(trace, "it", interpolation=interpolation).satisfied == true
