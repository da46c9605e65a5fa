"""ρ at time 0 is the first value of ρ at every sample, bit for bit, and so are its errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec.errors import S2RError, TraceError
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.examples import examples

PREDICATES = [
    "x <= p", "x + y > 0.3", "abs(x) < 1.2", "x * y >= -0.5", "x == y", "norm(x, y) <= 1.5", "max(x, -y) > 0",
    "x / y < 2", "sqrt(x) <= 1", "x^2 < y", "x^3 < 1", "1 / (x - 0.25) < 3", "x / 4 != y", "flag",
    "deriv(x) <= 2", "delay(x, 0.3) < 1", "integral(y) < 0.7", "integral(y, 0.4) < 0.2", "mean(x, 0.5) <= 0.3",
    "duration(x > 0) < 0.6", "count(y < 0, 0.5) <= 3", "if(x > 0, y, 2 * x) < 1", "overshoot(x, y) < 1",
    "init(x) - x <= 0.4", "sign(x) >= 0", "sign(x / y) >= 0", "abs(sqrt(x)) < 1",
    "if(x / y > 0, x, y) < 1", "count(x / y > 1) < 3", "mean(x / y, 0.3) < 1",
    "count(rise(x > 0)) < 3", "if(eventually[0, 0.5] (x > 1), x, y) < 1",
    "true",
]  # fmt: skip
ENDS = st.sampled_from([0.0, 0.1, 0.2, 0.25, 0.3, 0.5, 1.0])


@st.composite
def intervals(draw):
    low, more = draw(ENDS), draw(st.sampled_from([0.1, 0.2, 0.35, 0.7, None]))
    kind = draw(st.sampled_from(["[]", "()", "(]", "[)"]))
    if more is None:
        return draw(st.sampled_from(["", f"[{low}, inf)"]))
    return f"{kind[0]}{low}, {round(low + more, 3)}{kind[1]}"


FORMULAS = st.recursive(
    st.sampled_from(PREDICATES).map(lambda text: f"({text})"),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["not", "next", "prev", "rise", "fall"]), inner).map(lambda a: f"({a[0]} ({a[1]}))"),
        st.tuples(inner, st.sampled_from(["and", "or", "->", "<->"]), inner).map(lambda a: f"({' '.join(a)})"),
        st.tuples(st.sampled_from(["always", "eventually", "historically", "once"]), intervals(), inner).map(
            lambda a: f"({a[0]}{a[1]} {a[2]})"
        ),
        st.tuples(inner, st.sampled_from(["until", "since", "release", "unless"]), intervals(), inner).map(
            lambda a: f"({a[0]} {a[1]}{a[2]} {a[3]})"
        ),
    ),
    max_leaves=4,
)  # fmt: skip


@st.composite
def traces(draw):
    n, period = draw(st.sampled_from([1, 2, 3, 5, 12, 25, 40])), draw(st.sampled_from([0.1, 0.05, 1 / 30]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    times = period * np.arange(n) + draw(st.sampled_from([0.0, -2.3, 1e6]))
    if draw(st.booleans()):
        times += period * rng.uniform(0.0, draw(st.sampled_from([1e-6, 1e-3, 0.4])), n)
    x, y = (np.round(rng.normal(size=n), draw(st.integers(0, 3))) + 0.0 for _ in range(2))
    if draw(st.integers(0, 9)) == 0:
        x[rng.integers(n)] = draw(st.sampled_from([np.inf, -np.inf, 1e200]))
    return Trace(times, {"x": x, "y": y, "flag": (rng.uniform(size=n) < 0.7).astype(float)})


def outcome(evaluate):
    try:
        return evaluate()
    except S2RError as error:
        return type(error), str(error)


@settings(max_examples=examples(1500), deadline=None)
@given(FORMULAS, traces(), st.sampled_from([-0.5, 0.0, 0.7]), st.sampled_from(["open", "closed"]))
def test_rho_at_time_0_is_the_first_of_all(text, trace, p, until):
    spec = parse_spec(f"signal x signal y signal flag bool param p in [-1, 1] require it: {text}")
    options = {"params": {"p": p}, "until": until}

    def of_all():
        every = spec.evaluate(trace, "it", **options)
        return float(every.values[0]).hex(), every.satisfied

    def at_0():
        at = spec.robustness(trace, partial=True, **options)["it"]
        return at.hex(), spec.satisfied(trace, partial=True, **options)["it"]

    assert outcome(at_0) == outcome(of_all)
    complete = outcome(lambda: bool(spec.evaluate(trace, "it", **options).complete[0]))
    if complete is False:
        refused = outcome(lambda: spec.robustness(trace, **options))
        assert refused[0] is TraceError
        assert "longer trace" in refused[1]


@pytest.mark.parametrize(
    "text",
    [
        "always[0, 1] sign(x / y) < 2",
        "always[0, 1] x / y < 2",
        "always[0, 1] sqrt(y) < 2",
        "eventually[0, 1] x - y < 2",
    ],
)
def test_a_predicate_without_a_value_past_the_horizon_is_an_error_still(text):
    spec = parse_spec(f"signal x signal y require it: {text}")
    x = np.ones(1000)
    x[-1] = np.inf if "-" in text else 0.0
    y = np.ones(1000)
    y[-1] = np.inf if "-" in text else 0.0 if "/" in text else -1.0
    trace = Trace(0.01 * np.arange(1000), {"x": x, "y": y})
    refused = outcome(lambda: spec.robustness(trace))
    assert "sample 999" in refused[1]
    assert refused == outcome(lambda: spec.evaluate(trace, "it"))


@pytest.mark.parametrize(
    ("text", "rho"), [("deriv(x) <= 2", -8.0), ("next deriv(x) <= 2", -8.0), ("next next x >= 2", 1.0)]
)
def test_a_slope_at_the_first_sample_reads_the_second(text, rho):
    trace = Trace(0.1 * np.arange(5), {"x": [0.0, 1.0, 3.0, 2.0, 1.0]})
    assert parse_spec(f"signal x require it: {text}").robustness(trace)["it"] == rho
