"""What a trace makes of what Python hands to it."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pandas as pd
import pint
import pytest

import s2r_spec as s2r
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


WALK = Trace(np.arange(31) / 20, {"vx": np.arange(31.0), "q": np.arange(62.0).reshape(31, 2)}, {"vx": "m/s"})


def test_a_part_has_both_of_its_ends_and_keeps_its_times():
    part = WALK.between(0.15, 0.3)
    assert part.times.tolist() == [0.15, 0.2, 0.25, 0.3]
    assert part["q"][0].tolist() == [6, 7]
    assert part.shift(-part.times[0]).times[0] == 0
    assert len(WALK.between(timedelta(milliseconds=150), float("inf"))) == 28
    assert Trace([0, 0.1 + 0.2], {}).between(0, 0.3).times.size == 2  # rounding is no reason to lose a sample


def test_a_failure_stays_with_a_part():
    fell = Trace([0, 1, 2], {}, meta={"failure": "fall"})
    assert fell.between(0, 1).failure == "fall"


def test_resampled_at_its_own_times_a_trace_is_unchanged():
    for rule in ("hold", "linear"):
        again = WALK.resample(0.05, rule)
        assert np.array_equal(again.times, WALK.times)
        assert np.array_equal(again["q"], WALK["q"])
        assert again.units == WALK.units


def test_hold_takes_the_sample_before_and_linear_a_value_between():
    trace = Trace([0, 1, 3], {"a": [0, 1, 3], "b": [0, 1, 3]}).resample(0.5, {"a": "linear"})
    assert trace.times.tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3]
    assert trace["a"].tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3]
    assert trace["b"].tolist() == [0, 0, 1, 1, 1, 1, 3]


def test_a_resampled_trace_never_ends_after_the_trace():
    assert Trace([0, 1], {"v": [0, 1]}).resample(0.3).times.tolist() == pytest.approx([0, 0.3, 0.6, 0.9])


def test_renamed_channels_keep_their_units():
    trace = WALK.rename({"vx": "speed"})
    assert list(trace.channels) == ["speed", "q"]
    assert trace.units == {"speed": "m/s"}
    assert WALK.rename({"vx": "q", "q": "vx"})["q"].ndim == 1


@pytest.mark.parametrize(
    "wrong",
    [
        lambda t: t.between(2, 3),
        lambda t: t.between(1, 0),
        lambda t: t.between("a", 1),
        lambda t: t.between(0, float("nan")),
        lambda t: t.shift("1"),
        lambda t: t.shift(float("inf")),
        lambda t: t.resample(0),
        lambda t: t.resample(2),
        lambda t: t.resample(1e-12),
        lambda t: t.resample(0.1, "cubic"),
        lambda t: t.resample(0.1, {"vy": "hold"}),
        lambda t: t.rename({"vy": "v"}),
        lambda t: t.rename({"vx": "q"}),
        lambda t: t.rename({"vx": 3}),
    ],
)
def test_nonsense_gets_one_sentence(wrong):
    with pytest.raises(TraceError) as caught:
        wrong(WALK)
    assert "\n" not in str(caught.value)


def test_the_one_line_of_a_trace_has_rate_span_and_units():
    assert repr(WALK) == "Trace(31 samples at 20 Hz, 0 s to 1.5 s; vx [m/s], q(2))"
    dated = Trace(1718000000.0 + np.arange(3) / 10, {}, meta={"failure": "fall"})
    assert all(word in repr(dated) for word in ("10 Hz", "1718000000", "fall"))
    assert "about 1 Hz" in repr(Trace([0, 1, 2, 9], {}))
    many = Trace([0], {f"c{k}": [0] for k in range(99)})
    assert len(repr(many)) < 150


def test_the_table_of_a_trace_is_escaped_and_has_no_script():
    text = Trace([0], {"<script>alert(1)</script>\n": [np.nan]}, {})._repr_html_()
    assert "<script" not in text
    assert "\n" not in text
    assert "&lt;script&gt;" in text


def test_a_quantity_keeps_its_unit_and_times_become_seconds():
    units = pint.UnitRegistry()
    trace = Trace(
        units.Quantity(np.array([0, 20]), "ms"), {"v": units.Quantity(np.array([3.6, 7.2]), "km/hour")}
    )
    assert trace.times.tolist() == pytest.approx([0, 0.02])
    spec = s2r.parse_spec("signal v {m/s}\nrequire slow: v <= 2 {m/s}")
    assert spec.robustness(trace)["slow"] == pytest.approx(1)
    with pytest.raises(TraceError, match="meter"):
        Trace(units.Quantity(np.array([0, 20]), "m"), {})


def test_names_are_looked_up_and_a_loop_is_refused():
    assert "vx" in WALK
    assert "vy" not in WALK
    with pytest.raises(TypeError):
        iter(WALK)
    with pytest.raises(TraceError, match=naming("0", "vx")):
        WALK[0]


@pytest.mark.parametrize(
    ("given", "remedy"),
    [(pd.DataFrame({"t": [0]}), "v"), ("walk.csv", "read_trace"), (None, "Trace")],
)
def test_what_is_no_trace_is_said_with_the_remedy(given, remedy):
    spec = s2r.parse_spec("signal v {m/s}\nrequire slow: v <= 2 {m/s}")
    for call in (
        spec.robustness,
        spec.satisfied,
        lambda trace: spec.explain(trace, "slow"),
        lambda trace: spec.evaluate(trace, "slow"),
        lambda trace: spec.plot(trace, "slow"),
    ):
        with pytest.raises(TraceError, match=remedy):
            call(given)
