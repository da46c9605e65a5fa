"""What a trace makes of what Python hands to it."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace
from tests.errors import naming

COUNTS = 1718000000_100000000 + 20_000_001 * np.arange(3)
EXACT = [0.0, 0.020000001, 0.040000002]


@pytest.mark.parametrize(
    ("times", "seconds"),
    [
        (COUNTS.astype("M8[ns]"), EXACT),
        ((COUNTS // 1000).astype("M8[us]"), [0, 0.02, 0.04]),
        (np.array([0, 250, 500], "m8[ms]"), [0, 0.25, 0.5]),
        (np.array([10, 20, 30], "m8[25us]"), [0.00025, 0.0005, 0.00075]),
        (np.array(["2024-01", "2024-02", "2024-03"], "M8[M]"), [0, 31 * 86400, 60 * 86400]),
        ([datetime(2024, 6, 10, 6, 0, 0, 100000) + k * timedelta(milliseconds=20) for k in range(3)],
         [0, 0.02, 0.04]),
        ([datetime(2024, 6, 10, 6, tzinfo=UTC), datetime(2024, 6, 10, 8, 0, 1, tzinfo=timezone(timedelta(hours=2)))],
         [0, 1]),
        ([timedelta(milliseconds=k) for k in (1, 2, 4)], [0.001, 0.002, 0.004]),
    ],
)  # fmt: skip
def test_typed_times_become_seconds(times, seconds):
    assert Trace(times, {}).times.tolist() == seconds


def test_typed_times_that_are_none():
    with pytest.raises(TraceError, match=naming("1")):
        Trace(np.array(["2024-01-01", "NaT"], "M8[s]"), {})
    with pytest.raises(TraceError, match="unit"):
        Trace(np.array([1, 2]).view("m8"), {})


def test_channels_that_numpy_would_bend():
    trace = Trace(
        [0, 1], {"gap": np.ma.array([1, 2], mask=[False, True]), "delay": np.array([5, 7], "m8[ms]")}
    )
    assert str(trace["gap"].tolist()) == "[1.0, nan]"
    assert trace["delay"].tolist() == [0.005, 0.007]
    assert dict(trace.units) == {"delay": "s"}
    for wrong in ([1j, 2], np.array(["2024-01-01"] * 2, "M8[D]"), ["a", "b"], [[1], [1, 2]]):
        with pytest.raises(TraceError, match="'v'"):
            Trace([0, 1], {"v": wrong})


@pytest.mark.parametrize("word", [None, False, 0, "", " ", np.bool_(False)])
def test_what_says_no_is_no_failure(word):
    assert Trace([0], {}, meta={"failure": word}).failure is None


@pytest.mark.parametrize(("word", "said"), [("fall", "fall"), (True, "failure"), (1, "failure")])
def test_what_is_a_failure(word, said):
    assert Trace([0], {}, meta={"failure": word}).failure == said


@pytest.mark.parametrize(
    "wrong",
    [
        {"meta": {"failure": ["fall"]}},
        {"meta": ["fall"]},
        {"meta": None},
        {"units": {"v": 3}},
        {"units": ["m/s"]},
        {"units": {"v": None}},
    ],
)
def test_units_and_meta_of_other_types(wrong):
    with pytest.raises(TraceError):
        Trace([0], {"v": [1]}, **wrong)


def test_stamps_that_do_not_increase_are_printed_to_the_sample():
    epoch = 1718000000.0
    with pytest.raises(TraceError, match=naming("sample 2", "1.512 s", "1718000001.512 s")):
        Trace([epoch, epoch + 1.513, epoch + 1.512], {})
