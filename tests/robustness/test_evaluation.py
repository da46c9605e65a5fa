"""What an evaluation reports besides ρ, and continuous time worked out by hand."""

import gc
import math
import weakref

import numpy as np
import pytest

from s2r_spec.errors import TraceError, UsageError
from s2r_spec.spec import Spec, parse_spec
from s2r_spec.trace import Trace
from tests.errors import naming

NEAR = "signal x\nrequire it: always[0.5, 1] (x > 0)"
RAMP = Trace(np.arange(4) * 0.5, {"x": [1, 2, 3, 4]})


def spec(formula: str) -> Spec:
    return parse_spec(f"signal x\nsignal y\nrequire it: {formula}", "a.stl")


def test_an_evaluation_says_how_much_of_it_the_trace_decides() -> None:
    found = parse_spec(NEAR).evaluate(RAMP, "it")
    assert (found.value, found.horizon, found.complete_until, found.jitter) == (2, 1, 0.5, 0)
    assert found.values.tolist() == [2, 3, 4, math.inf]
    assert found.complete.tolist() == [True, True, False, False]
    assert found.undefined.tolist() == [False, False, False, True]
    nothing = parse_spec("signal x require it: always[0, 9] (x > 0)").evaluate(RAMP, "it")
    assert nothing.complete_until is None


def test_an_unbounded_operator_is_decided_by_what_there_is() -> None:
    found = parse_spec("signal x require it: always (x > 0)").evaluate(RAMP, "it")
    assert (found.horizon, found.complete_until) == (math.inf, 1.5)


@pytest.mark.parametrize("interpolation", ["samples", "hold", "linear"])
def test_policies_at_the_end_of_a_trace(interpolation) -> None:
    def values(end: str) -> list[float]:
        return parse_spec(NEAR).evaluate(RAMP, "it", interpolation=interpolation, end=end).values.tolist()

    assert values("clip") == [2, 3, 4, math.inf]
    assert values("hold") == [2, 3, 4, 4]
    np.testing.assert_array_equal(values("nan"), [2, 3, math.nan, math.nan])
    with pytest.raises(TraceError, match=naming("'it'", "t = 1 s", "1 s ahead")):
        values("error")


def test_a_missing_sample_may_be_the_one_before() -> None:
    gap = Trace([0, 1, 2, 3], {"x": [1, math.nan, math.nan, 4]})
    assert spec("x > 0").evaluate(gap, "it", nan="hold").values.tolist() == [1, 1, 1, 4]
    with pytest.raises(TraceError, match=naming("'x'", "NaN", "sample 0")):
        spec("x > 0").evaluate(Trace([0, 1], {"x": [math.nan, 1]}), "it", nan="hold")


def test_jitter_below_a_percent_is_recorded_and_more_is_no_grid() -> None:
    it = spec("always[0, 1] x > 0")
    assert it.evaluate(Trace([0, 1.004, 2], {"x": [1, 2, 3]}), "it").jitter == pytest.approx(0.004)
    found = it.evaluate(Trace([0, 1.04, 2], {"x": [1, 2, 3]}), "it")
    # 1.04 s is not within 1 s of 0 s, but 2 s is within 1 s of it
    assert (found.jitter, found.values.tolist()) == (None, [1, 2, 3])


def test_a_window_between_two_samples_is_refused() -> None:
    sparse = Trace([0, 1, 5, 6], {"x": [1, 2, 3, 4]})
    with pytest.raises(
        TraceError, match=naming("`[1, 2]`", "line 3 of a.stl", "sample 1", "1 s", "interpolation")
    ):
        spec("always[1, 2] x > 0").evaluate(sparse, "it")
    with pytest.raises(UsageError, match=naming("end='hold'")):
        spec("always[0, 2] x > 0").evaluate(sparse, "it", end="hold")
    assert spec("always[1, 2] x > 0").evaluate(sparse, "it", interpolation="hold").values.tolist() == [
        2, 2, 4, math.inf]  # fmt: skip


# x goes 0, 4, 0 and y goes 4, 0, 0 at 0, 1, 2 s: they cross at 0.5 s, both 2
CROSSING = Trace([0, 1, 2], {"x": [0, 4, 0], "y": [4, 0, 0]})


@pytest.mark.parametrize(
    ("formula", "samples", "hold", "linear"),
    [
        ("always[0, 1] (x > 0 or y > 0)", 4, 4, 2),
        ("eventually[0, 1] (x > 0 and y > 0)", 0, 0, 2),
        ("eventually[0, 1] (min(x, y) > 0)", 0, 0, 2),
        ("always[0, 1] (abs(x - y) > 0)", 4, 4, 0),
        ("eventually[0.25, 1.25] (x > 0)", 4, 4, 4),
        ("always[0.25, 1.25] (y > 0)", 0, 0, 0),
        ("x < 3 until[0, 1] x > 2", 2, 2, 0.5),
        ("x < 3 until[0, 2] x > 3.5", 0.5, 0.5, -0.25),  # on the way to 3.5 it passes 3.25
        ("always[0, 2] (2 * x - y / 2 <= 6)", -2, -2, -2),
        ("eventually[0, 1) (y < 1)", -3, -3, 1),
    ],
)
def test_between_two_samples(formula: str, samples: float, hold: float, linear: float) -> None:
    it = spec(formula)
    assert it.robustness(CROSSING) == {"it": samples}
    assert it.robustness(CROSSING, interpolation="hold") == {"it": hold}
    assert it.robustness(CROSSING, interpolation="linear") == {"it": linear}


def test_continuous_time_has_no_next_sample() -> None:
    with pytest.raises(
        UsageError, match=naming("`next x > 0`", "line 3 of a.stl", "interpolation='samples'")
    ):
        spec("next x > 0").evaluate(CROSSING, "it", interpolation="linear")


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_a_predicate_without_a_value_in_continuous_time(interpolation) -> None:
    with pytest.raises(TraceError, match=naming("`sqrt(x - 1) >= 0`", "line 3 of a.stl", "0 s")):
        spec("always sqrt(x - 1) >= 0").evaluate(CROSSING, "it", interpolation=interpolation)


@pytest.mark.parametrize("interpolation", ["samples", "hold", "linear"])
def test_one_sample_is_a_trace(interpolation) -> None:
    found = spec("always[0, 1] (x > 0) or x > 5 until y > 0").evaluate(
        Trace([7], {"x": [3], "y": [1]}), "it", interpolation=interpolation
    )
    assert found.values.tolist() == [3]


def test_an_end_that_would_be_held_for_too_long_is_refused() -> None:
    it = spec("always[0, 1e9] x > 0")
    with pytest.raises(UsageError, match=naming("end='hold'", "2e+09", "1e+09 s", "interpolation='hold'")):
        it.evaluate(RAMP, "it", end="hold")
    assert it.evaluate(RAMP, "it", end="hold", interpolation="hold").values.tolist() == [1, 2, 3, 4]


def test_one_sample_has_no_next() -> None:
    with pytest.raises(TraceError, match=naming("'it'", "next sample", "one sample")):
        spec("next x > 0").robustness(Trace([0], {"x": [1]}))


def test_no_circle_keeps_the_samples_in_memory() -> None:
    spec = parse_spec("signal x require it: always[0, 1] (if(x > 0, x, count(x > 1)) <= 3)")
    trace = Trace(np.arange(9.0), {"x": np.ones(9)})
    samples = weakref.ref(trace.channels["x"])
    gc.disable()
    try:
        spec.robustness(trace, partial=True)
        spec.robustness_signal(trace, "it", interpolation="linear")
        del trace
        assert samples() is None
    finally:
        gc.enable()
