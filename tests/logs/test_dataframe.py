"""Data frames become traces and back: a frame is read as a file with the same columns."""

import sys
import warnings
from datetime import UTC, datetime, timedelta

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

from s2r_spec.errors import TraceError, TraceNote, UsageError
from s2r_spec.trace import Trace
from tests.errors import naming

TIMES = np.arange(5) / 10
TRACE = Trace(
    TIMES,
    {"vx": 2 * TIMES, "q": np.arange(15.0).reshape(5, 3), "w": TIMES[:, None], "gap": [1, np.nan, 3, 4, 5]},
    {"vx": "m/s", "q": "rad"},
    {"note": "x"},
)
DATES = pd.date_range("2024-06-10T06:00:00.1", periods=3, freq="20ms", tz="Europe/Berlin")


def values(trace):
    channels = {name: np.nan_to_num(samples, nan=-9.0).tolist() for name, samples in trace.channels.items()}
    return trace.times.tolist(), channels


@pytest.mark.parametrize("library", ["pandas", "polars", "pyarrow"])
def test_a_trace_comes_back_from_its_frame(library):
    again = Trace.from_dataframe(TRACE.to_dataframe(library))
    assert values(again) == values(TRACE)
    if library != "polars":  # it has no place for them
        assert (again.units, again.meta) == (TRACE.units, TRACE.meta)


@pytest.mark.parametrize(
    ("times", "seconds"),
    [
        (DATES, [0, 0.02, 0.04]),
        (DATES.tz_localize(None), [0, 0.02, 0.04]),
        (DATES.as_unit("us"), [0, 0.02, 0.04]),
        (pd.to_timedelta([1, 2, 4], unit="ms"), [0.001, 0.002, 0.004]),
    ],
)
def test_typed_times_of_pandas_are_seconds_in_an_index_or_a_column(times, seconds):
    for frame, name in (
        (pd.DataFrame({"v": [1, 2, 3]}, index=times), None),
        (pd.DataFrame({"v": [1, 2, 3]}, index=times.rename("stamp")), "stamp"),
        (pd.DataFrame({"v": [1, 2, 3], "stamp": times}), "stamp"),
    ):
        trace = Trace.from_dataframe(frame, time=name)
        assert trace.times.tolist() == seconds
        assert list(trace.channels) == ["v"]


@pytest.mark.parametrize(
    "times",
    [
        [timedelta(milliseconds=k) for k in (0, 250, 500)],
        [datetime(2024, 1, 1) + timedelta(milliseconds=k) for k in (0, 250, 500)],
        [datetime(2024, 1, 1, tzinfo=UTC) + timedelta(milliseconds=k) for k in (0, 250, 500)],
    ],
)
@pytest.mark.parametrize("made", [pl.DataFrame, pa.table])
def test_typed_times_of_polars_and_arrow_are_seconds(times, made):
    trace = Trace.from_dataframe(made({"t": times, "v": [1.0, None, 3.0]}))
    assert trace.times.tolist() == [0, 0.25, 0.5]
    assert np.isnan(trace["v"]).tolist() == [False, True, False]


def test_numbers_without_a_type_are_seconds_unless_a_unit_is_given():
    frame = pd.DataFrame({"stamp": [0, 20, 40], "v": [1, 2, 3]})
    with pytest.warns(TraceNote, match=naming("'stamp'", "20", 'time_unit="ms"')):
        assert Trace.from_dataframe(frame, time="stamp").times.tolist() == [0, 20, 40]
    assert Trace.from_dataframe(frame, time="stamp", time_unit="ms").times.tolist() == [0, 0.02, 0.04]
    counts = pd.DataFrame({"t": [1718000000_100000000 + 20_000_001 * k for k in range(3)]})
    assert Trace.from_dataframe(counts, time_unit="ns").times.tolist() == [0.0, 0.020000001, 0.040000002]
    with pytest.raises(TraceError, match='time_unit="ns"'):
        Trace.from_dataframe(counts)


def test_units_come_from_attrs_the_header_and_the_argument_the_last_one_first():
    frame = pd.DataFrame({"t": [0, 1], "v [m/s]": [1, 2], "w": [1, 2]})
    frame.attrs["units"] = {"w": "rad/s", "gone": "m"}
    assert Trace.from_dataframe(frame).units == {"v": "m/s", "w": "rad/s"}
    assert Trace.from_dataframe(frame, units={"w": "deg/s"}).units == {"v": "m/s", "w": "deg/s"}
    with pytest.raises(TraceError, match=naming("'x'")):
        Trace.from_dataframe(frame, units={"x": "m"})


@pytest.mark.parametrize(
    ("columns", "fault"),
    [
        ({"t": [0, 1, 0.5]}, "row 2"),
        ({"t": [0, np.nan, 1]}, "row 1"),
        ({"t": [0, "x", 1]}, "'t'"),
        ({"t": pd.to_datetime(["2024", None, "2025"], format="%Y")}, "row 1"),
        ({"t": []}, "samples"),
        ({"stamp": [0, 1]}, "'stamp'"),
    ],
)
def test_times_that_are_none_get_one_sentence(columns, fault):
    frame = pd.DataFrame(columns)
    frame["v"] = 1.0
    with pytest.raises(TraceError, match=naming(fault)) as caught:
        Trace.from_dataframe(frame)
    assert "\n" not in str(caught.value)
    assert "--" not in str(caught.value)


@pytest.mark.parametrize(
    "column",
    [[1, "a"], ["walk", "run"], [object(), 1], pd.to_datetime(["2024", "2025"], format="%Y"), [1j, 2]],
)
def test_a_column_without_numbers_is_left_out_with_one_sentence(column):
    frame = pd.DataFrame({"t": [0, 1], "ok": [1, 2], "odd": column})
    with pytest.warns(TraceNote, match="'odd'") as said:
        trace = Trace.from_dataframe(frame)
    assert list(trace.channels) == ["ok"]
    assert len(said) == 1


def test_truth_values_and_gaps_of_pandas_are_numbers():
    frame = pd.DataFrame(
        {"t": [0, 1], "n": pd.array([1, None], dtype="Int64"), "on": pd.array([True, None], dtype="boolean")}
    )
    assert values(Trace.from_dataframe(frame))[1] == {"n": [1, -9], "on": [1, -9]}


@pytest.mark.parametrize(
    "given", [[1, 2], {"t": [1]}, pd.Series([1, 2]), pl.Series([1, 2]), pl.LazyFrame({"t": [0, 1]}), None]
)
def test_what_is_no_frame_is_said(given):
    with pytest.raises(UsageError):
        Trace.from_dataframe(given)


def test_an_index_of_two_levels_and_a_name_that_is_taken_are_refused():
    with pytest.raises(TraceError, match="2 levels"):
        Trace.from_dataframe(pd.DataFrame({"v": [1]}, index=pd.MultiIndex.from_tuples([(0, 1)])))
    with pytest.raises(TraceError, match="'t'"):
        Trace([0], {"t": [1]}).to_dataframe()
    with pytest.raises(UsageError, match="dask"):
        TRACE.to_dataframe("dask")


@pytest.mark.parametrize(
    ("module", "use"),
    [
        ("pandas", lambda: TRACE.to_dataframe()),
        ("polars", lambda: TRACE.to_dataframe("polars")),
        ("pyarrow", lambda: Trace.from_dataframe(pd.DataFrame({"t": [0]}))),
        ("xarray", lambda: TRACE.to_xarray()),
    ],
)
def test_without_its_library_a_sentence_says_what_to_install(module, use, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(TraceError, match=naming(module, "pip install")):
        use()


def test_a_dataset_has_units_and_meta():
    found = TRACE.to_xarray()
    assert found["vx"].attrs == {"units": "m/s"}
    assert found["q"].sel(t=0.2).values.tolist() == [6, 7, 8]
    assert found.attrs == {"note": "x"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = Trace.from_dataframe(found[["vx", "gap"]].to_dataframe())
    assert values(again.only(["vx"])) == values(TRACE.only(["vx"]))
