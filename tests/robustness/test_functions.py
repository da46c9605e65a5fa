"""Functions of the past against loops, boolean signals, and both in continuous time."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec.errors import TraceError
from s2r_spec.spec import Spec, parse_spec
from s2r_spec.trace import Trace
from tests.errors import naming, states


def ago(times, t, seconds):
    """Index of the last sample at or before t − seconds."""
    return max([k for k in range(len(times)) if times[k] <= times[t] - seconds + 1e-9], default=0)


def area(times, x, start, end):
    """Integral of the straight lines through the samples, by pieces."""
    total = 0.0
    for k in range(len(times) - 1):
        left, right = max(times[k], start), min(times[k + 1], end)
        if left < right:
            total += (right - left) * np.interp((left + right) / 2, times[k : k + 2], x[k : k + 2])
    return total


def since(times, t, seconds):
    return max(times[0], times[t] - seconds)


DEFINITIONS = {
    "delay(x, 0.5)": lambda ts, x, t: x[ago(ts, t, 0.5)],
    "deriv(x)": lambda ts, x, t: (x[max(t, 1)] - x[max(t, 1) - 1]) / (ts[max(t, 1)] - ts[max(t, 1) - 1]),
    "integral(x)": lambda ts, x, t: area(ts, x, ts[0], ts[t]),
    "integral(x, 0.7)": lambda ts, x, t: area(ts, x, since(ts, t, 0.7), ts[t]),
    "mean(x, 0.7)": lambda ts, x, t: (
        area(ts, x, since(ts, t, 0.7), ts[t]) / (ts[t] - since(ts, t, 0.7)) if t else x[0]
    ),
    "mean(x)": lambda ts, x, t: area(ts, x, ts[0], ts[t]) / (ts[t] - ts[0]) if t else x[0],
    "duration(x >= 0)": lambda ts, x, t: (
        ts[t] - ts[min(k for k in range(t + 1) if min(x[k : t + 1]) >= 0)] if x[t] >= 0 else 0.0
    ),
    "count(x >= 0)": lambda ts, x, t: sum(v >= 0 for v in x[: t + 1]),
    "count(x >= 0, 0.5)": lambda ts, x, t: sum(
        x[k] >= 0 for k in range(t + 1) if ts[k] >= ts[t] - 0.5 - 1e-9
    ),
    "count(rise(x >= 0))": lambda ts, x, t: sum(x[k] >= 0 >= x[k - 1] for k in range(1, t + 1)),
    "if(x >= 0, 2 * x, -1)": lambda ts, x, t: 2 * x[t] if x[t] >= 0 else -1,
}


@cache
def spec_of(text: str) -> Spec:
    return parse_spec(f"signal x require it: {text} > 0")


@pytest.mark.parametrize("text", DEFINITIONS)
@settings(max_examples=40, deadline=None)
@given(
    x=st.lists(st.integers(-3, 3).map(lambda v: v + 0.5), min_size=2, max_size=12),
    gaps=st.lists(st.integers(1, 3), min_size=11, max_size=11),
    regular=st.booleans(),
)
def test_functions_as_defined(text: str, x, gaps, regular) -> None:
    steps = [1] * 11 if regular else gaps
    times = np.cumsum([0, *steps])[: len(x)] / 10
    found = spec_of(text).robustness_signal(Trace(times + 3, {"x": x}), "it")
    expected = [DEFINITIONS[text](times, x, t) for t in range(len(x))]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    held = spec_of(text).robustness_signal(Trace(times, {"x": x}), "it", interpolation="hold")
    np.testing.assert_allclose(held, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("text", ["delay(x, 1)", "deriv(x)", "integral(x, 1)", "mean(x, 1)", "count(x > 1)"])
@pytest.mark.parametrize("interpolation", ["samples", "hold", "linear"])
def test_functions_of_one_sample(text: str, interpolation) -> None:
    spec = parse_spec(f"signal x require it: {text} >= 0")
    expected = {"delay(x, 1)": 2, "mean(x, 1)": 2, "count(x > 1)": 1}.get(text, 0)
    assert spec.robustness(Trace([5], {"x": [2]}), interpolation=interpolation) == {"it": expected}


def test_units_of_functions() -> None:
    spec = parse_spec(
        "signal v {km/h} signal T {degC}\n"
        "require a: deriv(v) <= 1 {m/s^2} require b: integral(v) <= 1 {km} require c: mean(T) <= 300 {K}\n"
        "require d: duration(v > 1) <= 500 {ms} require e: count(v > 1) <= 3 require f: delay(v, 1 {min}) <= 2"
    )
    assert [spec.unit(name) for name in "abcdef"] == ["km/h/s", "km/h*s", "K", "s", "", "km/h"]
    rho = spec.robustness(Trace([0, 1], {"v": [0, 7.2], "T": [20, 20]}))
    assert rho["a"] == pytest.approx(3.6 - 7.2)


STEPS = Trace([0, 1, 2, 3], {"c": [0, 1, 1, 0], "x": [1, 2, 3, 4]})


@pytest.mark.parametrize("interpolation", ["samples", "hold", "linear"])
def test_a_boolean_signal_is_a_condition(interpolation) -> None:
    spec = parse_spec("signal c bool signal x require it: c -> x >= 2.5 require when: eventually c")
    found = spec.robustness_signal(STEPS, "it", interpolation=interpolation)
    np.testing.assert_allclose(found, [math.inf, -0.5, 0.5, math.inf])
    assert spec.robustness(STEPS, interpolation=interpolation)["when"] == math.inf
    assert spec.channels() == ("c", "x")


def test_a_boolean_signal_is_0_or_1_and_explains_itself() -> None:
    spec = parse_spec("signal c bool require it: always c", "a.stl")
    with pytest.raises(TraceError, match=naming("'c'", "bool", "0", "1")):
        spec.robustness(Trace([0, 1], {"c": [0, 0.5]}))
    assert states(
        str(spec.explain(STEPS, "it")), "it violated", "ρ = -inf", "`c`", "line 1", "t = 0 s", "false"
    )


def test_what_is_counted_ahead_belongs_to_the_horizon() -> None:
    assert parse_spec("signal x require it: count(eventually[0, 2] x > 0) >= 1").horizon() == 2
