"""The same text under the conventions of other tools, worked out by hand."""

import math

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.robustness.profiles import PROFILES
from tests.errors import naming

X = [3.0, 1.0, -1.0, 2.0]
Y = [-2.0, -1.0, 4.0, -3.0]
TRACE = s2r.Trace([0, 1, 2, 3], {"x": X, "y": Y})

UNTIL, AHEAD, WITHIN = "x > 0 until[0, 2] y > 0", "always[1, 2] x > 0", "eventually[0.5, 0.5] x > 0"
# UNTIL at 0: at the witness 2 s y = 4, and x is at least 1 before it, −1 at it. In straight lines y
#   meets the least of x so far at 1 + 2/7 s: y = −1 + 5 s, x = 1 − 2 s; from 1 s on it is the same.
#   At 2 s the witness is now: 4, −1. At 3 s y = −3 and stays.
MEET = 1 - 2 * 2 / 7
# AHEAD at 0: the least of 1 and −1; at 1: of −1 and 2; at 2: 2, cut or held; at 3: nothing, or the last value.
EXPECTED = {
    "s2r": ([1, 1, 4, -3], [-1, -1, 2, math.inf], None),
    "rtamt": ([1, 1, 4, -3], [-1, -1, 2, math.inf], None),
    "stlcgpp": ([-1, -1, -1, -3], [-1, -1, 2, 2], None),
    "tidystl": ([-1, -1, -1, -3], [-1, -1, 2, 2], None),
    "rtamt-dense": ([-1, -1, -1, -3], [-1, -1, 2, 2], [3, 1, -1, 2]),
    "moonlight": ([1, 1, math.nan, math.nan], [-1, -1, math.nan, math.nan], [3, 1, -1, math.nan]),
    "breach": ([MEET, MEET, -1, -3], [-1, -1, 2, 2], [2, 0, 0.5, 2]),
    "stlrom": ([MEET, MEET, -1, -3], [-1, -1, 2, 2], [2, 0, 0.5, 2]),
}


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize(("formula", "which"), [(UNTIL, 0), (AHEAD, 1), (WITHIN, 2)])
def test_by_hand(name: str, formula: str, which: int) -> None:
    spec = s2r.parse_spec(f"signal x signal y require it: {formula}")
    expected = EXPECTED[name][which]
    if expected is None:
        with pytest.raises(s2r.S2RError, match=naming("`[0.5, 0.5]`", "line 1")):
            spec.robustness_signal(TRACE, "it", **s2r.profile(name))
    else:
        found = spec.robustness_signal(TRACE, "it", **s2r.profile(name))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_the_first_time_alone() -> None:
    spec = s2r.parse_spec(f"signal x signal y require near: {UNTIL} require far: always[0, 9] x > -2")
    assert spec.robustness(TRACE, **s2r.profile("breach")) == {"near": pytest.approx(MEET), "far": 1}
    assert spec.robustness(TRACE, **s2r.profile("rtamt")) == {"near": 1, "far": 1}
    with pytest.raises(s2r.S2RError, match=naming("'far'", "9 s", "3 s")):
        spec.robustness(TRACE)


def test_a_profile_is_the_callers_own() -> None:
    s2r.profile("breach")["until"] = "open"
    assert s2r.profile("breach")["until"] == "closed"


def test_a_profile_that_there_is_not() -> None:
    with pytest.raises(s2r.S2RError, match=naming("'breech'", "did you mean 'breach'", *PROFILES)):
        s2r.profile("breech")
