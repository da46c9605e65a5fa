"""Robustness against its definitions (definitions.py), identities, and what the horizon promises."""

import math
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec.errors import TraceError, UsageError
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.examples import examples
from tests.robustness.definitions import NoSampleError, by_definition, evaluated, halvings
from tests.robustness.drawing import COMPARISONS, DENSE_FORMULAS, cases, intervals, text_of

SAMPLES = st.integers(1, 12).flatmap(
    lambda n: st.tuples(*(st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=n, max_size=n),) * 2)
)


def agrees(case) -> None:
    try:
        expected = by_definition(case)
    except NoSampleError:
        with pytest.raises(TraceError, match="no sample lies in"):
            evaluated(case)
        return
    np.testing.assert_allclose(evaluated(case), expected, rtol=0, atol=1e-9)


@settings(max_examples=examples(700), deadline=None)
@given(case=cases("regular"))
def test_every_sample_is_as_defined(case) -> None:
    agrees(case)


@settings(max_examples=examples(500), deadline=None)
@given(case=cases("irregular"))
def test_irregular_samples_are_as_defined(case) -> None:
    agrees(case)


@settings(max_examples=examples(600), deadline=None)
@given(case=cases("hold"))
def test_held_signals_are_as_defined(case) -> None:
    agrees(case)


@settings(max_examples=examples(200), deadline=None)
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


def test_a_bound_between_two_samples_is_refused() -> None:
    spec = parse_spec("signal x\nrequire it: always[0, 0.25 s] x > 0", "a.stl")
    with pytest.raises(UsageError) as caught:
        spec.robustness(Trace(np.arange(9) / 10, {"x": np.ones(9)}))
    assert str(caught.value) == (
        "the time 0.25 s in `[0, 0.25 s]` (line 2 of a.stl) is not a multiple of the sample period, 0.1 s; "
        "the nearest multiples are 0.2 s and 0.3 s"
    )


def test_an_interval_without_a_sample_is_refused() -> None:
    spec = parse_spec("signal x\nrequire it: always(0.1, 0.2) x > 0", "a.stl")
    with pytest.raises(
        UsageError, match=r"no sample lies in `\(0.1, 0.2\)` \(line 2 of a.stl\): the sample period"
    ):
        spec.robustness(Trace(np.arange(9) / 10, {"x": np.ones(9)}))
