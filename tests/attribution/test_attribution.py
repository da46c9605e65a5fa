"""Attribution adds up to Δρ, on random formulas and on real ones."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from s2r_spec.attribution.attribute import attribute
from s2r_spec.attribution.path import Path as Straight
from s2r_spec.base.json_values import line
from s2r_spec.errors import TraceError
from s2r_spec.spec import load_spec, parse_spec
from s2r_spec.trace import Trace
from tests.examples import examples
from tests.robustness.drawing import cases

SPECS = Path(__file__).parents[2] / "specs"


@st.composite
def pairs(draw):
    """A random formula and two traces of it."""
    case = draw(st.one_of(cases("regular"), cases("irregular")))
    sample = st.lists(
        st.integers(-6, 6).map(lambda v: v / 4), min_size=len(case.ticks), max_size=len(case.ticks)
    )
    times = case.start + np.array(case.ticks) * float(case.period)
    other = Trace(times, {"x": draw(sample), "y": draw(sample)})
    return case, Trace(times, {"x": case.x, "y": case.y}), other


@settings(max_examples=examples(60), deadline=None)
@given(pair=pairs())
def test_parts_add_up(pair):
    case, real, simulated = pair
    spec = parse_spec(case.text)
    try:
        found = attribute(spec, "it", real, simulated, {"p": case.param})
    except TraceError:
        assume(False)
    assume(math.isfinite(found.delta))
    total = sum(float(values.sum()) for values in found.credit.values())
    assert total + found.ended == pytest.approx(found.delta, abs=1e-9)
    assert abs(found.error) <= 1e-9
    assert found.parts[0].amount == pytest.approx(found.delta, abs=1e-9)
    predicates = sum(part.amount for part in found.parts if part.predicate)
    assert predicates == pytest.approx(found.delta, abs=1e-9)
    line(found.switch)


def test_crossings_ever_nearer_to_one_end_are_no_endless_way(monkeypatch):
    spec = parse_spec("signal x\nsignal y\nrequire it: always[0, 1 s] (x <= 2 or y <= 0)\n")
    times = np.array([0.0, 1.0])
    real, simulated = (
        Trace(times, {"x": np.full(2, x), "y": np.full(2, y)}) for x, y in ((4.0, 1.0), (0.0, 3.0))
    )
    # As of curved predicates, where straight lines cut off next to nothing each time.
    monkeypatch.setattr(Straight, "_crossing", lambda self, a, middle, b: a.at + 1e-3 * (b.at - a.at))
    found = attribute(spec, "it", real, simulated, {})
    assert found.delta == pytest.approx(-1.0 - 2.0)
    assert sum(float(values.sum()) for values in found.credit.values()) == pytest.approx(
        found.delta, abs=1e-9
    )


TIMES = np.arange(751) / 500


def walk(generator, speed=0.3, shape=0.0):
    noise = np.convolve(generator.normal(size=790), np.ones(40) / 40, "valid") * 0.05
    return Trace(TIMES, {"vx": speed * (1 - np.exp(-TIMES / 0.1)) + noise + shape}, {"vx": "m/s"})


def test_the_a1s_spec_sums_to_rounding_and_names_what_switches():
    spec, generator = load_spec(SPECS / "a1_velocity.stl"), np.random.default_rng(0)
    dip = np.where((TIMES >= 0.9) & (TIMES <= 1.1), -0.08, 0.0)
    start = np.where((TIMES > 0.35) & (TIMES < 0.45), 0.025, 0.0)  # where the simulated rollout is tightest
    found = attribute(
        spec, "walking", walk(generator, shape=start + dip), walk(generator, shape=start), {"vd": 0.3}
    )
    assert found.delta < -0.03
    assert abs(found.error) < 1e-12
    assert found.ended == 0.0
    near = (found.times >= 0.9) & (found.times <= 1.1)
    assert found.over_time[near].sum() / found.delta > 0.8
    assert [(part.name, part.depth) for part in found.parts if part.name] == [("rises", 1), ("settles", 1)]
    rises, settles = (part.amount for part in found.parts if part.name)
    assert rises + settles == pytest.approx(found.delta, abs=1e-12)
    assert settles / found.delta > 0.8
    text = spec.text
    assert [text[slice(*part.span)] for part in found.parts if part.predicate] == [
        "overshoot(vx, vd) <= tol_o", "abs(vx - vd) <= tol_s",
    ]  # fmt: skip
    assert found.switch.switches
    assert (found.switch.simulated.predicate, found.switch.simulated.name) == (
        "overshoot(vx, vd) <= tol_o",
        "rises",
    )
    assert (found.switch.real.predicate, found.switch.real.name) == ("abs(vx - vd) <= tol_s", "settles")
    assert 0.9 <= found.switch.real.time < 2.0
    for words in ("`overshoot(vx, vd) <= tol_o` in `rises`", "`abs(vx - vd) <= tol_s` in `settles`"):
        assert words in str(found.switch)


def test_a_fall_is_cut_and_what_it_costs_beyond_stands_by_itself():
    spec, generator = load_spec(SPECS / "a1_velocity.stl"), np.random.default_rng(1)
    whole = walk(generator)
    fallen = Trace(TIMES[:400], {"vx": whole["vx"][:400] - 0.02}, {"vx": "m/s"}, {"failure": "fall"})
    found = attribute(spec, "walking", fallen, whole, {"vd": 0.3})
    assert found.delta == pytest.approx(-0.5 - spec.robustness(whole, {"vd": 0.3})["walking"])
    assert found.reason == "the real rollout ended with 'fall' at 0.798 s"
    assert found.times.size == 400
    shown = float(found.over_time.sum())
    assert shown + found.ended == pytest.approx(found.delta, abs=1e-12)
    assert abs(shown) < 0.03 < abs(found.ended)
    sooner = Trace(TIMES[:300], {"vx": whole["vx"][:300]}, {"vx": "m/s"}, {"failure": "slip"})
    both = attribute(spec, "walking", fallen, sooner, {"vd": 0.3})
    assert both.reason == "the simulated rollout ended with 'slip' at 0.598 s"


def test_other_rates_and_other_clocks():
    spec, generator = load_spec(SPECS / "a1_velocity.stl"), np.random.default_rng(2)
    real, simulated = walk(generator, shape=-0.01), walk(generator)
    slow = Trace(TIMES[::5] + 100.0, {"vx": 100 * real["vx"][::5]}, {"vx": "cm/s"})
    found = attribute(spec, "walking", slow, simulated, {"vd": 0.3})
    assert found.times[0] == 100.0
    assert float(found.over_time.sum()) + found.ended == pytest.approx(found.delta, abs=1e-12)
    assert abs(found.ended) < 0.01


def test_booleans_jump_at_once_and_are_credited():
    spec = load_spec(SPECS / "no_slip.stl")
    times = np.arange(100) / 100
    contact = (np.arange(100) % 40 < 20).astype(float)
    late = np.roll(contact, 8)
    generator = np.random.default_rng(3)
    feet = [
        np.column_stack([0.3 * (1 - c) + 0.01 * generator.normal(size=100)] * 3) for c in (contact, contact)
    ]
    units = {"vfoot": "m/s"}
    real = Trace(times, {"contact": late, "vfoot": feet[0]}, units)
    simulated = Trace(times, {"contact": contact, "vfoot": feet[1]}, units)
    found = attribute(spec, "no_slip", real, simulated, {})
    assert set(found.credit) == {"contact", "vfoot[0]", "vfoot[1]", "vfoot[2]"}
    assert found.delta < -0.02
    assert float(found.over_time.sum()) == pytest.approx(found.delta, abs=1e-12)
    assert found.credit["contact"].sum() / found.delta > 0.8


def test_curved_predicates_to_rounding():
    spec = parse_spec(
        "signal u[2] signal x\n"
        "require it: always (norm(u) * x <= 2 and sqrt(abs(x)) + x^2 <= 3) or eventually (x >= 3 * u[0])"
    )
    generator = np.random.default_rng(4)
    for _ in range(5):
        real, simulated = (
            Trace(np.arange(20.0), {"u": generator.normal(size=(20, 2)), "x": generator.normal(size=20)})
            for _ in range(2)
        )
        found = attribute(spec, "it", real, simulated, {})
        assert abs(found.error) < 1e-9


def test_an_infinite_rho_is_left_alone():
    spec = parse_spec("signal x require it: eventually[5, 6] x > 0")
    trace = Trace(np.arange(3.0), {"x": [1.0, 2.0, 3.0]})
    found = attribute(spec, "it", trace, trace, {})
    assert math.isnan(found.delta)
    assert found.over_time.tolist() == [0.0, 0.0, 0.0]
    assert found.switch is None
