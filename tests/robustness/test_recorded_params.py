"""A trace is evaluated at the parameters that it was recorded with, and a data frame is a trace."""

import numpy as np
import pandas as pd
import pytest

import s2r_spec as s2r
from s2r_spec.errors import TraceError, UsageError

SPEC = s2r.parse_spec(
    "signal v {m/s}\nparam vd {m/s} in [0, 1]\nrequire near: always (abs(v - vd) <= 0.1 {m/s})"
)


def trace(**meta):
    return s2r.Trace(np.arange(10) / 10, {"v": np.full(10, 0.5)}, {"v": "m/s"}, meta)


def test_the_trace_says_which_test_it_was():
    recorded = trace(params={"vd": 0.55, "of another spec": 3.0})
    assert SPEC.robustness(recorded)["near"] == pytest.approx(0.05)
    assert SPEC.satisfied(recorded) == {"near": True}
    assert SPEC.evaluate(recorded, "near").value == pytest.approx(0.05)
    assert "0.55" in str(SPEC.explain(recorded, "near"))


def test_a_given_value_goes_before_the_recorded_one():
    assert SPEC.robustness(trace(params={"vd": 0.55}), {"vd": 0.7})["near"] == pytest.approx(-0.1)


def test_a_value_that_is_nowhere_is_asked_for():
    with pytest.raises(UsageError, match="vd"):
        SPEC.robustness(trace())
    with pytest.raises(TraceError, match="vd"):
        SPEC.robustness(trace(params={"vd": "fast"}))


def test_a_data_frame_is_a_trace():
    frame = pd.DataFrame({"t": np.arange(10) / 10, "v": np.full(10, 0.5)})
    assert SPEC.robustness(frame, {"vd": 0.5})["near"] == pytest.approx(0.1)
