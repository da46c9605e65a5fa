"""Robustness against its definitions (definitions.py), identities, and what the horizon promises."""

import math
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec.errors import SamplingError, TraceError
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.errors import naming
from tests.examples import examples
from tests.robustness.definitions import NoSampleError, Truth, by_definition, evaluated, halvings, too_short
from tests.robustness.drawing import COMPARISONS, DENSE_FORMULAS, cases, intervals, text_of

SAMPLES = st.integers(1, 12).flatmap(
    lambda n: st.tuples(*(st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=n, max_size=n),) * 2)
)


def agrees(case) -> None:
    if too_short(case):
        with pytest.raises(SamplingError):
            evaluated(case)
        return
    try:
        expected = by_definition(case)
    except NoSampleError:
        with pytest.raises(TraceError, match=r"`[\[(].+` \(line 4\b"):
            evaluated(case)
        return
    found = evaluated(case)
    np.testing.assert_allclose(found.values, expected, rtol=0, atol=1e-9)
    # the numbers drawn are quarters, so that many ρ are 0: there the comparisons decide
    assert found.truth.tolist() == by_definition(case, Truth)


@settings(max_examples=examples(450), deadline=None)
@given(case=cases("regular"))
def test_every_sample_is_as_defined(case) -> None:
    agrees(case)


@settings(max_examples=examples(350), deadline=None)
@given(case=cases("irregular"))
def test_irregular_samples_are_as_defined(case) -> None:
    agrees(case)


@settings(max_examples=examples(350), deadline=None)
@given(case=cases("hold"))
def test_held_signals_are_as_defined(case) -> None:
    agrees(case)


@settings(max_examples=examples(60), deadline=None)
@given(case=cases("linear").filter(lambda case: halvings(case.formula) <= 3))
def test_straight_lines_are_as_defined(case) -> None:
    agrees(case)


FUTURE = st.recursive(
    COMPARISONS.filter(lambda node: "init" not in repr(node) and "overshoot" not in repr(node)),
    lambda inner: st.one_of(
        st.tuples(st.just("not"), inner),
        st.tuples(st.sampled_from(["and", "or", "->", "<->"]), inner, inner),
        st.tuples(st.sampled_from(["always", "eventually"]), intervals(), inner),
        st.tuples(st.sampled_from(["until", "release", "unless"]), intervals(), inner, inner),
    ),
    max_leaves=4,
)
_PRODUCTS = re.compile(r"\*|norm|init|overshoot")


@settings(max_examples=examples(150), deadline=None)
@given(
    formula=DENSE_FORMULAS.filter(lambda node: not _PRODUCTS.search(text_of(node, Fraction(1)))),
    x=st.lists(st.floats(-2, 2), min_size=6, max_size=6),
    y=st.lists(st.floats(-2, 2), min_size=6, max_size=6),
    gaps=st.lists(st.floats(0.5, 2), min_size=5, max_size=5),
)
def test_samples_on_a_straight_line_change_nothing(formula, x, y, gaps) -> None:
    """Lines of any slope, which the lattice of the definitions does not have."""
    times = np.concatenate(([0.0], np.cumsum(gaps)))
    more = np.sort(np.concatenate((times, (times[1:] + times[:-1]) / 2)))
    spec = parse_spec(f"signal x signal y param p = 1 require it: {text_of(formula, Fraction(1))}")
    few = Trace(times, {"x": x, "y": y})
    many = Trace(more, {"x": np.interp(more, times, x), "y": np.interp(more, times, y)})
    rho = spec.robustness_signal(few, "it", interpolation="linear")
    again = spec.robustness_signal(many, "it", interpolation="linear")[::2]
    np.testing.assert_allclose(again, rho, rtol=0, atol=1e-9)


def test_a_sign_is_nothing_where_it_crosses_however_the_crossing_is_rounded() -> None:
    spec = parse_spec("signal x signal y require it: always 0.5 != x + sign(y)")
    times = np.array([0.0, 1.375])
    for more in (times, np.array([0.0, 0.6875, 1.375])):
        trace = Trace(more, {"x": more / 1.375, "y": np.interp(more, times, [-0.6875, 1.0])})
        rho = spec.robustness_signal(trace, "it", interpolation="linear")[0]
        assert rho == pytest.approx(0.5 - 0.6875 / 1.6875)


DUALS = [
    ("not always[0.1, 0.3) (x > 0)", "eventually[0.1, 0.3) not (x > 0)"),
    ("not (x > 0 until(0, 0.4] y > 0)", "(not x > 0) release(0, 0.4] (not y > 0)"),
    ("x > 0 until[0, 0.3] y > 0", "x > 0 until y > 0 and eventually[0, 0.3] y > 0"),
    ("eventually[0, 0.3] x > 0", "true until[0, 0.3] x > 0"),
    ("not historically[0, 0.2] x > 0", "once[0, 0.2] x <= 0"),
    ("x > 0 unless y > 0", "(x > 0 until y > 0) or always x > 0"),
    ("x > 0 -> y > 0", "not x > 0 or y > 0"),
    ("always[0.1, 0.2] always[0, 0.2] x > 0", "always[0.1, 0.4] x > 0"),
]


@pytest.mark.parametrize(("left", "right"), DUALS)
@settings(max_examples=25, deadline=None)
@given(samples=SAMPLES)
def test_identities(left: str, right: str, samples) -> None:
    spec = parse_spec(f"signal x signal y require left: {left} require right: {right}")
    trace = Trace(np.arange(len(samples[0])) / 10, {"x": samples[0], "y": samples[1]})
    np.testing.assert_array_equal(
        spec.robustness_signal(trace, "left"), spec.robustness_signal(trace, "right")
    )


@settings(max_examples=examples(60), deadline=None)
@given(formula=FUTURE, samples=SAMPLES, more=st.integers(1, 3))
def test_the_past_does_not_matter_to_a_future_formula(formula, samples, more: int) -> None:
    spec = parse_spec(f"signal x signal y param p = 1 require it: {text_of(formula, Fraction(1, 10))}")

    def rho(x: list, y: list) -> np.ndarray:
        return spec.robustness_signal(Trace(np.arange(len(x)) / 10, {"x": x, "y": y}), "it")

    x, y = samples
    np.testing.assert_array_equal(rho([9.0] * more + x, [-9.0] * more + y)[more:], rho(x, y))


@settings(max_examples=examples(60), deadline=None)
@given(formula=FUTURE, samples=SAMPLES)
def test_the_horizon_is_enough(formula, samples) -> None:
    spec = parse_spec(f"signal x signal y param p = 1 require it: {text_of(formula, Fraction(1, 10))}")
    if not math.isfinite(spec.horizon()):
        return
    x, y = ([*values, *[0.5] * 60] for values in samples)
    whole = Trace(np.arange(len(x)) / 10, {"x": x, "y": y})
    n = round(spec.horizon() * 10) + 1
    cut = Trace(whole.times[:n], {name: values[:n] for name, values in whole.channels.items()})
    if n <= len(x):
        assert spec.robustness(cut) == spec.robustness(whole)


@pytest.mark.parametrize(
    ("interval", "first", "last"),
    [("[0, 0.25]", 0, 2), ("[0.15, 0.4]", 2, 4), ("(0.15, 0.35)", 2, 3), ("[0.05, 0.3)", 1, 2)],
)
def test_a_bound_between_two_samples_means_the_samples_inside(interval, first, last) -> None:
    spec = parse_spec(f"signal x\nrequire it: always{interval} x > 0", "a.stl")
    for k in range(9):
        x = np.where(np.arange(9) == k, -1.0, 1.0)
        found = spec.evaluate(Trace(np.arange(9) / 10, {"x": x}), "it")
        assert found.satisfied == (not first <= k <= last)
        assert found.narrowest is not None
        assert "between two samples" in found.notes[0]


@pytest.mark.parametrize("times", [np.arange(9) * 100.0, np.arange(9) * 1e8, np.cumsum(range(1, 10)) * 50.0])
@pytest.mark.parametrize(
    "formula", ["always[0, 2 s] x > 0", "x > 0 until[1, 2] x < 9", "count(x > 0, 2) > 0", "mean(x, 2) > 0",
                "historically(0, 2) x > 0", "always[0, 1e-7] x > 0"],
)  # fmt: skip
def test_a_window_that_is_shorter_than_the_period_is_refused(times, formula) -> None:
    spec = parse_spec(f"signal x\nrequire it: {formula}", "a.stl")
    trace = Trace(times, {"x": np.ones(9)})
    for ask in (spec.robustness, spec.satisfied):
        with pytest.raises(SamplingError, match=r"line 2 of a.stl"):
            ask(trace, partial=True)
    for ask in (spec.evaluate, spec.explain):
        with pytest.raises(SamplingError, match=r"line 2 of a.stl"):
            ask(trace, "it")


@pytest.mark.parametrize(("period", "unit"), [(100, "ms"), (1e5, "us"), (1e8, "ns")])
def test_the_likely_unit_is_named(period, unit) -> None:
    spec = parse_spec("signal x\nrequire it: always[0, 2 s] x > 0")
    with pytest.raises(SamplingError, match=f"--time-unit {unit}\\b"):
        spec.robustness(Trace(np.arange(30) * period, {"x": np.ones(30)}))


def test_a_punctual_window_is_short_and_meant() -> None:
    spec = parse_spec("signal x\nrequire it: x > 0 and next x > 0 and always[2, 2] x > 0")
    assert spec.satisfied(Trace(np.arange(9.0), {"x": np.ones(9)})) == {"it": True}


def test_a_sparse_window_is_answered_where_it_is_asked_for() -> None:
    spec = parse_spec("signal x\nrequire it: always[0, 2 s] x > 0")
    found = spec.evaluate(Trace(np.arange(9) * 5.0, {"x": np.ones(9)}), "it", sparse=True)
    assert (found.satisfied, found.narrowest, found.period, found.duration) == (True, 1, 5.0, 40.0)


@pytest.mark.parametrize("drift", [-3e-4, 3e-4, 8e-3])
def test_a_clock_that_drifts_is_evaluated_as_one_that_jitters(drift) -> None:
    spec = parse_spec("signal x\nrequire it: always[0, 0.5 s] x > 0")
    times = np.arange(600) * 1e-3 * (1 + drift)
    inside = int(np.floor(0.5 / (1e-3 * (1 + drift)) + 1e-6))
    for bad, verdict in ((inside, False), (inside + 1, True)):
        x = np.where(np.arange(600) == bad, -1.0, 1.0)
        found = spec.evaluate(Trace(times, {"x": x}), "it")
        assert (found.satisfied, found.narrowest) == (verdict, inside + 1)


def test_an_interval_without_a_sample_is_refused() -> None:
    spec = parse_spec("signal x\nrequire it: always(0.1, 0.2) x > 0", "a.stl")
    with pytest.raises(TraceError, match=naming("`(0.1, 0.2)`", "line 2 of a.stl", "0.1 s")):
        spec.robustness(Trace(np.arange(9) / 10, {"x": np.ones(9)}))
