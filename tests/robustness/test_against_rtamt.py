"""ρ beside that of RTAMT, another monitor: the same numbers under the profiles of its two kinds of time."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings

from s2r_spec.robustness.profiles import profile
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.examples import examples
from tests.robustness.drawing import TIMED, text_of
from tests.robustness.rtamt_runs import Pair, in_dense_time, in_discrete_time, pairs, written

pytest.importorskip("rtamt", reason="RTAMT is in the [dev] extra, for Python up to 3.12")
pytestmark = pytest.mark.dev


def here(pair: Pair, name: str) -> np.ndarray:
    spec = parse_spec(f"signal x signal y require it: {text_of(pair.formula, Fraction(1, 10))}")
    trace = Trace(np.array(pair.ticks) * 0.1, {"x": pair.x, "y": pair.y})
    return spec.robustness_signal(trace, "it", **profile(name))


@settings(max_examples=examples(120), deadline=None)
@given(pair=pairs(dense=False))
def test_discrete_time(pair: Pair) -> None:
    there = in_discrete_time(written(pair.formula), pair.x, pair.y)
    np.testing.assert_allclose(here(pair, "rtamt"), there, rtol=0, atol=1e-9)


def beyond_the_end(node: tuple, inside: bool = False) -> bool:
    """Whether an operator without end stands over one with a window: RTAMT's dense time lets it see times after
    the last sample, to which a window reaches."""
    if not isinstance(node, tuple):
        return False
    timed = node[0] in (*TIMED, "unless", "release")
    if timed and inside and node[1] is not None:
        return True
    return any(beyond_the_end(part, inside or (timed and node[1] is None)) for part in node[1:])


@settings(max_examples=examples(80), deadline=None)
@given(pair=pairs(dense=True).filter(lambda pair: not beyond_the_end(pair.formula)))
def test_dense_time(pair: Pair) -> None:
    there = np.array(in_dense_time(written(pair.formula), pair.ticks, pair.x, pair.y))
    found = here(pair, "rtamt-dense")
    np.testing.assert_allclose(found[~np.isnan(there)], there[~np.isnan(there)], rtol=0, atol=1e-9)


X, Y = [1.0, 2.0, -1.0, 3.0, 0.0], [0.0, 1.0, 2.0, -2.0, 1.0]


@pytest.mark.parametrize(
    ("there", "here"),
    [
        # false or true where there is no sample
        ("next (x >= 1)", "not next not x >= 1"),
        ("s_next (x >= 1)", "next x >= 1"),
        ("prev (x >= 1)", "not prev not x >= 1"),
        ("s_prev (x >= 1)", "prev x >= 1"),
        # an edge at the first sample
        ("rise(x >= 1)", "x >= 1 and not prev x >= 1"),
        ("fall(x >= 1)", "x < 1 and not prev x < 1"),
        # implications from the left
        ("(x >= 1) -> (y >= 1) -> (x >= 2)", "(x >= 1 -> y >= 1) -> x >= 2"),
        ("always[0,1] (x >= 1) and (y >= 1)", "(always[0, 1] x >= 1) and y >= 1"),
        ("(x >= 1) or (y >= 1) -> (x >= 2)", "x >= 1 or y >= 1 -> x >= 2"),
        ("(x >= 0) and (x >= 1) until (y >= 1)", "x >= 0 and (x >= 1 until y >= 1)"),
    ],
)
def test_what_another_text_says(there: str, here: str) -> None:
    trace = Trace(np.arange(5), {"x": X, "y": Y})
    found = parse_spec(f"signal x signal y require it: {here}").robustness_signal(trace, "it")
    assert found.tolist() == in_discrete_time(there, X, Y)


def test_what_has_no_equal() -> None:
    # RTAMT's equivalence is minus a distance, and never holds with a margin
    trace = Trace(np.arange(5), {"x": X, "y": Y})
    found = parse_spec("signal x signal y require it: x >= 1 <-> y >= 1").robustness_signal(trace, "it")
    assert in_discrete_time("(x >= 1) <-> (y >= 1)", X, Y) == [-1, -1, -3, -5, -1]
    assert found.tolist() == [0, 0, -1, -2, 0]
    # a chain of comparisons is one of numbers there
    assert math.isclose(in_discrete_time("(0 <= x) <= 2", X, Y)[1], 0)
    # and a bound in milliseconds is a thousand times too long in its dense time
    ticks = range(5)
    inside, whole = (
        in_dense_time(f"always[{within}] (x >= 1)", ticks, X, Y) for within in ("0,1", "0:1000ms")
    )
    assert (inside, whole) == ([0, -2, -2, -1, -1], [-2, -2, -2, -1, -1])
    # an eventually without end sees what a window makes of the time after the last sample
    last = [0.0, 0.0, 0.25]
    assert in_dense_time("eventually historically[0,1] (x < y)", range(3), [0.0] * 3, last) == [0.25] * 3
    spec = parse_spec("signal x signal y require it: eventually historically[0, 1] (x < y)")
    trace = Trace(np.arange(3), {"x": [0.0] * 3, "y": last})
    assert spec.robustness_signal(trace, "it", **profile("rtamt-dense")).tolist() == [0.0] * 3
