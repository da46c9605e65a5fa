"""Tables as other tools write them: each is read as its writer meant it, or one sentence says what to change."""

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec import logs
from s2r_spec.errors import NoTimesError, TraceError
from s2r_spec.logs.formats.follow import follow
from s2r_spec.logs.interpret import request
from s2r_spec.logs.summary import summary
from s2r_spec.trace import Trace
from tests.errors import naming, states
from tests.examples import examples
from tests.logs import tables

T = 0.02 * np.arange(50)
V = np.where(np.arange(50) == 30, 1.6, 0.4)


@pytest.fixture(params=tables.ENDINGS)
def path(request, tmp_path: Path) -> Path:
    return tmp_path / f"log{request.param}"


def both(path: Path, text: str, columns=None) -> tuple[Trace, tuple[str, ...]]:
    """Return what the reader of files and the reader of a stream agree on: the trace, and the notes of the file."""
    path.write_text(text)
    found = logs.load(path, columns, ["v"])
    rows = follow(io.StringIO(text).readline, request(columns, ["v"], None))
    samples = list(rows.samples)
    assert [time for time, _ in samples] == found.trace.times.tolist()
    assert [sample["v"] for _, sample in samples] == found.trace["v"].tolist()
    assert rows.units == found.trace.units
    return found.trace, found.notes


def refused(path: Path, text: str, *facts: str, columns=None) -> None:
    """Check that both readers refuse a text, with these facts."""
    path.write_text(text)
    with pytest.raises(TraceError, match=naming(path.name, *facts)):
        logs.load(path, columns, ["v"])
    with pytest.raises(TraceError, match=naming(*facts)):
        list(follow(io.StringIO(text).readline, request(columns, ["v"], None)).samples)


# -- a row of units ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("head", "first", "unit"),
    [
        ("t,v,pitch\ns,m/s,deg\n", 1.0, "m/s"),  # mdfreader, asammdf
        ("t,v,state\n[ms],[km/h],[-]\n", 1e-3, "km/h"),
        ('"t","v","mode"\n"(us)","(m/s)",""\n', 1e-6, "m/s"),
        ("t,v,w\n\n-,m/s,-\n", 1.0, "m/s"),
        ("t [s],v,w\ns,m/s,-\n", 1.0, "m/s"),
    ],
)
def test_a_row_of_units_below_the_names_is_one(tmp_path, head, first, unit):
    trace, notes = both(tmp_path / "a.csv", f"{head}0,0.4,3\n20,1.6,3\n")
    assert trace.times == pytest.approx([0, 20 * first])
    assert trace.units == {"v": unit}
    assert any(states(note, f"line {head.count(chr(10))}", "units") for note in notes)


def test_a_row_of_units_is_no_row_of_a_large_file(tmp_path, monkeypatch):
    monkeypatch.setattr("s2r_spec.logs.formats.csv_bulk.FROM", 1)
    trace, _ = both(tmp_path / "a.csv", "t,v\nms,m/s\n0,0.4\n20,1.6\n40,0.4\n")
    assert (trace.times.tolist(), trace["v"].tolist()) == ([0, 0.02, 0.04], [0.4, 1.6, 0.4])
    with (tmp_path / "a.csv").open("a") as stream:
        stream.write("60,fast\n")
    with pytest.raises(TraceError, match=naming("line 6", "column 2")):
        logs.load(tmp_path / "a.csv", None, ["v"])


@pytest.mark.parametrize(
    "text",
    ["state,t,v\nm,0,1.6\ns,0.1,0.4\n", "t,v,state\n0,1.6,m\n0.1,0.4,s\n", "t,v,w\n0,1.6,\n0.1,0.4,\n"],
)
def test_a_first_sample_with_text_that_is_a_unit_is_a_sample(tmp_path, text):
    trace, notes = both(tmp_path / "a.csv", text)
    assert trace["v"].tolist() == [1.6, 0.4]
    assert not notes


def test_a_row_of_units_must_not_contradict_the_names(tmp_path):
    refused(tmp_path / "a.csv", "t [s],v\nms,m/s\n0,1\n", "line 2", "'ms'", "'s'")
    refused(tmp_path / "b.csv", "t,v (km/h)\ns,m/s\n0,1\n", "line 2", "'m/s'", "'km/h'")


def test_a_row_that_is_nearly_one_of_units_is_named_with_the_way_out(tmp_path):
    refused(tmp_path / "a.csv", "t,v,ok\ns,m/s,bool\n0,1,1\n", "line 2", "'bool'", "t [s]")


# -- other lines above or below the names -----------------------------------------------------------------------------

MOTIVE = """\
Format Version,1.23,Take Name,Take 1,Capture Frame Rate,120.000000,Rotation Type,Quaternion,Length Units,Millimeters

,,Rigid Body,Rigid Body,Rigid Body
,,robot,robot,robot
,,1,1,1
,,Position,Position,Position
Frame,Time (Seconds),X,Y,Z
0,0.000000,0.1,0.2,0.3
1,0.008333,0.1,0.2,0.3
"""
VICON = (
    "Trajectories\n100\n,robot:base,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,0.1,0.2,0.3\n2,0,0.1,0.2,0.3\n"
)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (MOTIVE, 7),
        (VICON, 4),
        ("Logger,Foo\nRate,100\nt,v,w\n0,0.5,1\n0.1,1.6,1\n", 3),
        ("Logger Foo 1.2\nRate: 100 Hz\n\nt,v\n0,0.5\n0.1,1.6\n", 4),
        ("sep=,\nt,v\n0,0.5\n0.1,1.6\n", 2),
        ("left,left\nspeed,time\nt,v\n0,0.5\n0.1,1.6\n", 3),
        ("Unit,mm\nt,v\n0 days 00:00:00,0.5\n0 days 00:00:00.1,1.6\n", 2),
    ],
)
def test_lines_above_the_names_are_refused_with_the_line_of_the_names(tmp_path, text, line):
    """They may state units, as Motive's do, so nobody skips them in silence."""
    refused(tmp_path / "a.csv", text, "line 1", f"line {line}")
    refused(
        tmp_path / "a.csv", text, f"line {line}", columns={"t": "Time (Seconds)", "v": "X"}
    ) if line != 7 else None
    with pytest.raises(TraceError, match=naming(f"line {line}")):
        summary(tmp_path / "a.csv")


def test_a_table_without_names_is_said(tmp_path):
    refused(tmp_path / "a.csv", "0,0.5\n0.1,1.6\n", "line 1", "t,v")


@pytest.mark.parametrize("mark", [";", "\t", " ", "|"])
@pytest.mark.parametrize("first", ["", "sep={mark}\n"])
@pytest.mark.parametrize("comma", [",", "."])
def test_other_marks_between_values_are_named(tmp_path, mark, first, comma):
    text = f"{first.format(mark=mark)}t{mark}v\n0{comma}0{mark}0{comma}5\n0{comma}1{mark}0{comma}6\n"
    facts = [repr(mark)] if not first or mark == ";" else []
    refused(tmp_path / "a.csv", text, "line", *facts)


def test_a_decimal_comma_is_named_with_its_place(tmp_path):
    refused(tmp_path / "a.csv", '"t","v"\n"0,0","0,5"\n', "line 2", "column 1", "'0,0'", "decimal point")
    refused(tmp_path / "a.csv", '"t","v"\n0,"0,5"\n', "line 2", "column 2", "'0,5'", "decimal point")


# -- durations and times of day ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (
            ["-1 days +23:59:59.900000", "0 days 00:00:00", "1 days 02:00:00.5"],
            [-0.1, 0.0, 93600.5],
        ),  # pandas
        (["0 days", "0 days 00:00:00.000000001", "0 days 00:00:01"], [0.0, 1e-9, 1.0]),
        (
            ["1 day, 0:00:00", "1 day, 0:00:00.100000", "2 days, 1:00:00"],
            [86400.0, 86400.1, 176400.0],
        ),  # Python
        (["-PT0.1S", "PT0S", "P1DT1H1M1.5S"], [-0.1, 0.0, 90061.5]),  # ISO 8601
    ],
)
def test_durations_as_text_are_seconds(path, texts, seconds):
    tables.write(path, t=texts, v=[1.0, 2.0, 3.0])
    assert logs.load(path).trace.times.tolist() == seconds


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["10:00:00.000", "10:00:00.100", "10:00:01"], [0.0, 0.1, 1.0]),
        (["9:59:59,9", "10:00:00,0", "10:00:00,1"], [0.0, 0.1, 0.2]),
        (["23:59:59", "24:00:00", "100:00:00"], [0.0, 1.0, 273601.0]),  # hours since a start
    ],
)
def test_times_of_day_count_from_the_first_sample(path, texts, seconds):
    tables.write(path, t=texts, v=[1.0, 2.0, 3.0])
    found = logs.load(path)
    assert found.trace.times.tolist() == seconds
    assert found.begins


@settings(deadline=None, max_examples=examples(100))
@given(st.integers(0, 86_399_999), st.lists(st.integers(1, 5000), min_size=1, max_size=5))
def test_a_time_of_day_is_exact_and_the_same_row_by_row(tmp_path_factory, first, steps):
    counts = first + np.concatenate(([0], np.cumsum(steps)))
    counts = counts[counts < 86_400_000]
    rows = [
        f"{n // 3_600_000:02}:{n // 60_000 % 60:02}:{n // 1000 % 60:02}.{n % 1000:03},1\n"
        for n in counts.tolist()
    ]
    trace, _ = both(tmp_path_factory.mktemp("day") / "a.csv", "t,v\n" + "".join(rows))
    assert trace.times.tolist() == ((counts - first) / 1000).tolist()


def test_a_time_of_day_that_goes_back_asks_for_the_date(tmp_path):
    refused(tmp_path / "a.csv", "t,v\n23:59:59.9,1\n00:00:00.0,2\n", "line 3", "'00:00:00.0'", "date")


@pytest.mark.parametrize(
    "second", ["1 day, 0:00:00", "2024-06-10T10:00:01", "10:00:01 AM", "soon", "10:61:00"]
)
def test_times_of_another_form_are_named(tmp_path, second):
    refused(tmp_path / "a.csv", f't,v\n10:00:00,1\n"{second}",2\n', "line 3", second)


def test_a_time_unit_is_not_for_durations(path):
    for text in ("0 days 00:00:01", "10:00:00"):
        tables.write(path, t=[text], v=[1.0])
        with pytest.raises(TraceError, match="'ms'"):
            logs.load(path, time_unit="ms")


# -- Simulink, and times under any name -------------------------------------------------------------------------------


def saved(path: Path, **variables) -> Path:
    """Write variables as a MATLAB file, or as groups and data sets of HDF5."""
    if path.suffix == ".mat":
        from scipy.io import savemat

        savemat(path, variables)
        return path
    import h5py

    def put(group, values):
        for name, value in values.items():
            if isinstance(value, dict):
                put(group.create_group(name), value)
            else:
                group[name] = value

    with h5py.File(path, "w") as stream:
        put(stream, variables)
    return path


@pytest.fixture(params=[".mat", ".h5"])
def arrays(request, tmp_path: Path) -> Path:
    return tmp_path / f"run{request.param}"


def times(path: Path, v: str, t: str | None = None, **options) -> list[float]:
    columns = {"v": v} if t is None else {"v": v, "t": t}
    trace = logs.load(path, columns, {"v": None}, **options).trace
    assert trace["v"].tolist() == V.tolist()
    return trace.times.tolist()


def test_simulink_saves_tout_and_structures_with_time(tmp_path):
    signals = np.zeros((1, 2), dtype=[("values", "O"), ("label", "O")])
    signals[0, 0], signals[0, 1] = (V[:, None], "v"), (V.reshape(1, 1, -1), "w")
    one = {
        "time": T[:, None],
        "signals": {"values": V[:, None], "dimensions": 1.0, "label": "v"},
        "blockName": "m/Out",
    }
    path = saved(tmp_path / "a.mat", tout=T[:, None], yout=np.stack([V, -V], 1), simout=one,
                 logsout={"time": T, "signals": signals})  # fmt: skip
    for name in ("yout[0]", "simout.signals.values", "logsout.signals_1.values", "logsout.signals_2.values"):
        assert times(path, name) == T.tolist()
    assert {topic.name for topic in summary(path).topics} == {"", "simout", "logsout"}


def test_structures_of_matlab_7_3_are_those_of_earlier_versions(tmp_path):
    import h5py

    with h5py.File(tmp_path / "a.mat", "w") as stream:
        kept = [
            stream.create_dataset(f"#refs#/{name}", data=values[None])
            for name, values in (("b", V), ("c", -V))
        ]
        stream["yout/time"] = T[None]
        stream["yout/signals/values"] = np.array([[one.ref for one in kept]], dtype=h5py.ref_dtype)
        stream["list"] = stream["yout/signals/values"][()]
        stream["tout"] = T[None]
        stream["list"].attrs["MATLAB_class"] = np.bytes_("cell")
        for one in (*kept, stream["yout/time"], stream["tout"]):
            one.attrs["MATLAB_class"] = np.bytes_("double")
    assert times(tmp_path / "a.mat", "yout.signals_1.values") == T.tolist()
    assert times(tmp_path / "a.mat", "list_1") == T.tolist()


def test_an_object_of_matlab_is_named_with_its_class(tmp_path):
    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    numbers = element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    inner = element(14, element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
                    + numbers)  # fmt: skip
    names = element(1, b"logsout") + element(1, b"MCOS") + element(1, b"Simulink.SimulationData.Dataset")
    begin = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    (tmp_path / "old.mat").write_bytes(
        begin + element(14, element(6, struct.pack("<II", 17, 0)) + names + inner)
    )
    import h5py

    with h5py.File(tmp_path / "new.mat", "w") as stream:
        stream["logsout"] = np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype="u4")
        stream["logsout"].attrs["MATLAB_class"] = np.bytes_("Simulink.SimulationData.Dataset")
        stream["logsout"].attrs["MATLAB_object_decode"] = np.int32(3)
    for name in ("old.mat", "new.mat"):
        with pytest.raises(TraceError, match=naming(name, "'logsout'", "Simulink.SimulationData.Dataset")):
            logs.load(tmp_path / name)


def test_times_under_any_name_are_mapped_by_path(arrays):
    saved(arrays, run={"zeit": T, "v": V, "n": np.arange(7)}, base={"clk": 2 * T}, ms={"a": 1000 * T, "v": V})
    assert times(arrays, "run.v", "run.zeit") == T.tolist()
    assert times(arrays, "run.v", "zeit") == T.tolist()
    assert times(arrays, "run.v", "base.clk") == (2 * T).tolist()
    assert times(arrays, "ms.v", "ms.a", time_unit="ms") == pytest.approx(T)
    for name, facts in {"run.n": ["run.n", "7", "50"], "run.zei": ["'run.zei'", "run.zeit"]}.items():
        with pytest.raises(TraceError, match=naming(*facts)):
            times(arrays, "run.v", name)
    with pytest.raises(TraceError, match=naming("run.zeit", "t=NAME")):
        times(arrays, "run.v")


def test_what_the_user_maps_goes_before_every_word_for_times(arrays):
    saved(arrays, t=3 * T, tout=T, v=V, run={"time": 2 * T, "v": V}, short={"time": T[:20], "v": V[:20]})
    assert times(arrays, "v") == (3 * T).tolist()
    assert times(arrays, "v", "tout") == T.tolist()
    assert times(arrays, "run.v") == (2 * T).tolist()
    assert times(arrays, "run.v", "tout") == T.tolist()
    with pytest.raises(TraceError, match=naming("tout", "50", "20", "short.time")):
        logs.load(arrays, {"t": "tout", "v": "short.v"}, ["v"])


def test_times_of_two_lengths_beside_each_other_are_not_mixed(arrays):
    saved(arrays, t=T[:20], tout=T, v=V, w=V[:20])
    assert len(logs.load(arrays, None, ["w"]).trace) == 20
    with pytest.raises(TraceError, match=naming("'v'", "'tout'", "'t'")):
        logs.load(arrays, None, ["v"])
    assert times(arrays, "v", "tout") == T.tolist()
    (topic,) = summary(arrays).topics
    assert any(states(sentence, "v", "t=tout") for sentence in topic.left_out)


# -- two columns that may be the times ---------------------------------------------------------------------------------


def asked(path: Path, columns: dict, *facts: str) -> None:
    with pytest.raises(NoTimesError, match=naming(path.name, *facts)) as caught:
        logs.load(path, columns, ["v"])
    assert len(caught.value.candidates) == 2


def test_two_candidates_in_a_table_are_a_question(path):
    tables.write(path, time=T, timestamp=1_718_000_000 + 2 * T, v=V)
    asked(path, {}, "'time'", "'timestamp'", "0 s", "0.02 s", "0.04 s", "1.718e+09 s")
    assert logs.load(path, {"t": "time"}, ["v"]).trace.times.tolist() == T.tolist()
    assert states(" ".join(summary(path).notes), "'time'", "'timestamp'", "t=time")
    tables.write(path, t=3 * T, time=T, timestamp=2 * T, v=V)
    assert logs.load(path, None, ["v"]).trace.times.tolist() == (3 * T).tolist()


def test_a_candidate_that_holds_no_times_is_none(path):
    tables.write(path, time=T, time_source=["gps"] * 50, v=V)
    with pytest.raises(NoTimesError, match=naming("t=time")) as caught:
        logs.load(path, None, ["v"])
    assert caught.value.likely == "time"
    assert not caught.value.candidates


def test_a_pair_of_seconds_and_nanoseconds_is_one_candidate(path):
    whole = {"header.stamp.sec": [5, 5, 6], "header.stamp.nanosec": [0, 500_000_000, 0]}
    tables.written(path, {**whole, "v": [1.0, 2.0, 3.0]})
    assert logs.load(path, {"t": "header.stamp"}, ["v"]).trace.times.tolist() == [5, 5.5, 6]
    tables.written(path, {**whole, "time": [0.0, 0.25, 0.5], "v": [1.0, 2.0, 3.0]})
    asked(path, {}, "'header.stamp'", "'time'", "0.5 s", "0.25 s")


def test_two_columns_of_one_name_are_told_apart_by_their_units(tmp_path):
    path = tmp_path / "a.csv"
    for name in ("Time", "t"):
        path.write_text(f"{name} [s],{name} [ms],v\n0,0,1\n0.02,40,2\n")
        asked(path, {"t": name}, f"'{name} [s]'", f"'{name} [ms]'", "0.02 s", "0.04 s")
        assert logs.load(path, {"t": f"{name} [ms]"}, ["v"]).trace.times.tolist() == [0, 0.04]


def test_two_candidates_in_a_folder_of_arrays_are_a_question(arrays):
    saved(arrays, run={"time": T, "timestamp": 2 * T, "v": V}, other={"time": T, "v": V})
    asked(arrays, {"v": "run.v"}, "'time'", "'timestamp'", "0 s", "0.02 s", "0.04 s")
    assert times(arrays, "other.v") == T.tolist()
    for name in ("timestamp", "run.timestamp"):
        assert times(arrays, "run.v", name) == (2 * T).tolist()
    found = summary(arrays)
    assert {topic.name for topic in found.topics} == {"run", "other"}
    assert states(" ".join(found.notes), "'time'", "'timestamp'", "t=time")


def test_two_candidates_in_a_data_frame_are_a_question():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"time": T, "timestamp": 2 * T, "v": V})
    for given_ in (frame, frame.rename(columns={"time": "Zeit time", "timestamp": "stamp"})):
        with pytest.raises(TraceError, match=naming("0.02 s", "0.04 s", f"time='{given_.columns[0]}'")):
            Trace.from_dataframe(given_)
    assert Trace.from_dataframe(frame, time="timestamp").times.tolist() == (2 * T).tolist()
    assert Trace.from_dataframe(frame.assign(t=3 * T)).times.tolist() == (3 * T).tolist()


def test_two_candidates_in_a_stream_are_a_question():
    with pytest.raises(NoTimesError, match=naming("'time'", "'datetime'")):
        follow(io.StringIO("time,datetime,v\n").readline, request(None, ["v"], None))


# -- whole numbers without a unit --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "unit", "said"),
    [("time", None, True), ("time", "ms", False), ("time_s", None, False), ("t", None, False)],
)
def test_whole_numbers_without_a_unit_are_seconds_and_this_is_said(path, name, unit, said):
    tables.write(path, **{name: np.array([0, 20, 40]), "v": [1.0, 2.0, 3.0]})
    found = logs.load(path, {"t": name}, ["v"], time_unit=unit)
    assert any(states(note, f"'{name}'", "20", "--time-unit ms") for note in found.notes) == said
