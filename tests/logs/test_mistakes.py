"""What people's logs look like, each through every format: the answer is the same, or one sentence is."""

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from s2r_spec import logs
from s2r_spec.errors import TraceError, TraceNote, UsageError
from s2r_spec.logs.topics.collected import Element
from tests.errors import naming
from tests.logs import tables

V = [0.5, 1.5, 2.5, 3.5]
FIRST = 1718000000_100000000  # ns since 1970
EVERY = 20_000_001  # ns: no multiple of what float64 resolves there


@pytest.fixture(params=tables.ENDINGS)
def path(request, tmp_path: Path) -> Path:
    return tmp_path / f"log{request.param}"


def typed(path: Path) -> bool:
    return path.suffix != ".csv"


COUNTS = FIRST + EVERY * np.arange(4)
EXACT = [0.0, 0.020000001, 0.040000002, 0.060000003]


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
@pytest.mark.parametrize("kind", ["M8", "m8"])
def test_typed_times_keep_their_unit(path, unit, kind):
    if not typed(path) and kind == "m8":
        pytest.skip("CSV has no durations")
    ticks = np.array([3, 10, 17, 24], dtype="m8[ms]").astype(f"m8[{unit}]")
    stamps = ticks if kind == "m8" else np.datetime64("2024-06-10T06:13:20") + ticks
    tables.write(path, t=stamps, v=V)
    times = logs.read(path, wanted=["v"]).times
    assert times.tolist() == ([0.003, 0.010, 0.017, 0.024] if kind == "m8" else [0, 0.007, 0.014, 0.021])


def test_nanoseconds_since_1970_lose_nothing(path):
    tables.write(path, t=COUNTS, v=V)
    with pytest.raises(TraceError, match=r"--time-unit ns\b"):
        logs.read(path)
    assert logs.read(path, time_unit="ns").times.tolist() == EXACT
    # the user says that they are seconds: so be it
    tables.write(path, t=10**10 * COUNTS[:2] // 10**8, v=V[:2])
    assert logs.read(path, time_unit="s").times.tolist() == [float(t) for t in 10**10 * COUNTS[:2] // 10**8]


@pytest.mark.parametrize(("stamp", "unit"), [(1.7e12, "ms"), (1.7e15, "us"), (1.7e18, "ns")])
def test_what_cannot_be_seconds_names_the_likely_unit(path, stamp, unit):
    tables.write(path, stamp=[stamp, stamp * (1 + 1e-9)], v=V[:2])
    with pytest.raises(TraceError, match=naming(f"--time-unit {unit}")):
        logs.read(path, {"t": "stamp"})


@pytest.mark.parametrize(
    ("name", "unit", "scale"),
    [
        ("time_us", None, 1e6), ("TimeMS", None, 1e3), ("stamp.nanoseconds", None, 1e9), ("time (ms)", None, 1e3),
        ("t[us]", None, 1e6),
        ("clock", "min", 1 / 60), ("clock", "h", 1 / 3600), ("clock", "ms", 1e3), ("clock", None, 1),
        ("time_s", None, 1), ("time_us", "us", 1e6), ("bus", None, 1),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::s2r_spec.errors.TraceNote")
def test_the_unit_that_a_name_or_the_user_says(path, name, unit, scale):
    times = np.array([0.25, 0.5, 0.75, 1.0])
    tables.written(path, {name: times * scale, "v": V})
    assert logs.read(path, {"t": name}, time_unit=unit).times == pytest.approx(times, rel=1e-12)


def test_units_of_time_that_do_not_fit(path):
    tables.written(path, {"time (ms)": [0, 1, 2, 3], "v": V})
    assert logs.read(path, {"t": "time"}, time_unit="ms").times.tolist() == [0, 0.001, 0.002, 0.003]
    with pytest.raises(TraceError, match=naming("ms", "us")):
        logs.read(path, {"t": "time"}, time_unit="us")
    with pytest.raises(UsageError, match="'m'"):
        logs.read(path, {"t": "time"}, time_unit="m")
    tables.write(path, t=COUNTS.astype("M8[ns]"), v=V)
    with pytest.raises(TraceError, match=naming("dates", "'ns'")):
        logs.read(path, time_unit="ns")


@pytest.mark.parametrize(
    "texts",
    [
        ["2024-06-10T06:13:20.100Z", "2024-06-10T06:13:20.120000001Z", "2024-06-10T06:13:20.140000002Z"],
        [
            "2024-06-10 08:13:20.1+02:00",
            "2024-06-10 06:13:20.120000001Z",
            "2024-06-10T01:13:20.140000002-0500",
        ],
        ["2024/06/10 06:13:20.1", "2024/06/10 06:13:20,120000001", "2024/06/10 06:13:20.140000002"],
    ],
)
def test_dates_as_text(path, texts):
    tables.write(path, stamp=texts, v=V[:3])
    assert logs.read(path, {"t": "stamp"}, ["v"]).times.tolist() == EXACT[:3]


@pytest.mark.parametrize(
    ("texts", "facts"),
    [
        (["2024-06-10T06:13:20Z", "2024-06-10T06:13:21"], ["zone"]),
        (["2024-06-31T06:13:20", "2024-07-01T06:13:21"], ["2024-06-31T06:13:20"]),
        (["10 June", "11 June"], ["10 June"]),
        (["1066-10-14", "1066-10-15"], ["1066-10-14", "1678"]),
        (["2024-06-10T06:13:20Z", None], ["no time"]),
    ],
)
def test_dates_that_are_none(path, texts, facts):
    tables.write(path, stamp=texts, v=V[:2])
    with pytest.raises(TraceError, match=naming("stamp", *facts)):
        logs.read(path, {"t": "stamp"}, ["v"])


@pytest.mark.parametrize("names", [("h.stamp.sec", "h.stamp.nanosec"), ("h.stamp.secs", "h.stamp.nsecs")])
def test_seconds_and_nanoseconds_in_two_columns(path, names):
    tables.written(path, {names[0]: COUNTS // 10**9, names[1]: COUNTS % 10**9, "v": V})
    assert logs.read(path, {"t": "h.stamp"}, ["v"]).times.tolist() == EXACT
    assert logs.read(path, {"t": f"{names[0]}+{names[1]}"}, ["v"]).times.tolist() == EXACT
    with pytest.raises(TraceError, match=naming(f"'{names[0]}'", "--map t=h.stamp")):
        logs.read(path, {"t": names[0]}, ["v"])


def test_halves_of_times_that_are_none(path):
    tables.write(path, sec=[1, 2], nsec=[0, 10**9], v=V[:2])
    with pytest.raises(TraceError, match=naming("nsec", "1000000000", "sample 1")):
        logs.read(path, {"t": "sec+nsec"})
    tables.write(path, sec=[1, 2.5], nsec=[0, 1], v=V[:2])
    with pytest.raises(TraceError, match=naming("'sec'", "whole")):
        logs.read(path, {"t": "sec+nsec"})
    with pytest.raises(TraceError, match="'usec'"):
        logs.read(path, {"t": "sec+usec"})


def test_columns_that_nobody_reads(path):
    columns = {"": [0, 1, 2, 3], "mode": ["walk", "trot", None, "walk"], "gap": [None, 1.0, None, None]}
    columns |= {"never": [None] * 4} if path.suffix == ".parquet" else {}
    tables.written(path, columns | {"t": [0, 1, 2, 3], "v": V})
    assert list(logs.read(path, wanted=["v"]).channels) == ["v"]
    with pytest.warns(TraceNote, match=naming("'mode'", "'walk'")):
        everything = logs.read(path)
    assert {"v", "gap"} <= set(everything.channels)
    assert "mode" not in everything.channels
    with pytest.raises(TraceError, match=naming("mode", "'walk'")):
        logs.read(path, wanted=["v", "mode"])
    with pytest.raises(TraceError, match=naming("'speed'", "gap", "mode", "v")):
        logs.read(path, wanted=["speed"])


@pytest.mark.parametrize(
    "words",
    ["True False True", "yes no Yes", "on off ON", "t f T", "Y N y", "1 0 1", "true 0 1", "TRUE FALSE TRUE"],
)
def test_truth_values_as_people_write_them(path, words):
    tables.write(path, t=[0, 1, 2], flag=words.split())
    assert logs.read(path, wanted={"flag": None})["flag"].tolist() == [1, 0, 1]


def test_truth_values_with_a_gap_or_among_numbers(path):
    tables.write(path, t=[0, 1, 2], flag=["yes", None, "no"])
    assert str(logs.read(path)["flag"].tolist()) == "[1.0, nan, 0.0]"
    tables.write(path, t=[0, 1, 2], flag=["yes", "0.3", "no"])
    with pytest.raises(TraceError, match=naming("flag", "'yes'")):
        logs.read(path, wanted=["flag"])
    tables.write(path, t=[0, 1, 2], flag=np.array([True, False, True]))
    assert logs.read(path, wanted=["flag"])["flag"].tolist() == [1, 0, 1]


def test_gaps_are_nan_and_inf_is_a_number(path):
    tables.write(path, t=[0, 1, 2], v=[None, 2.0, float("-inf")])
    assert str(logs.read(path, wanted=["v"])["v"].tolist()) == "[nan, 2.0, -inf]"
    tables.write(path, t=[0, None, 2], v=V[:3])
    with pytest.raises(TraceError, match=naming("t", "no time")):
        logs.read(path, wanted=["v"])


Q = np.arange(12.0).reshape(4, 3)


@pytest.mark.parametrize("form", ["q_{}", "q.{}", "q/{}", "q{}", "q_0{}", "q[{}]"])
def test_numbered_columns_are_a_vector(path, form):
    tables.written(path, {"t": [0, 1, 2, 3], **{form.format(k): Q[:, k] for k in range(3)}, "v": V})
    assert logs.read(path, wanted={"q": 3, "v": None})["q"].tolist() == Q.tolist()
    assert logs.read(path, {"knee": "q[2]"}, {"knee": None})["knee"].tolist() == Q[:, 2].tolist()
    assert logs.read(path, {"p": "q"}, {"p": 3})["p"].tolist() == Q.tolist()
    turned = logs.read(path, {f"q[{2 - k}]": form.format(k) for k in range(3)}, {"q": 3})
    assert turned["q"].tolist() == Q[:, ::-1].tolist()


def test_a_column_of_vectors_has_components(path):
    tables.write(path, t=[0, 1, 2, 3], position=Q)
    trace = logs.read(path, {"knee": "position[1]", "q": "position", "u[1]": "position[0]", "u[0]": "position[2]"},
                      {"knee": None, "q": 3, "u": 2})  # fmt: skip
    assert trace["knee"].tolist() == Q[:, 1].tolist()
    assert trace["q"].tolist() == Q.tolist()
    assert trace["u"].tolist() == Q[:, [2, 0]].tolist()
    with pytest.raises(TraceError, match="position"):
        logs.read(path, {"knee": "position[3]"}, {"knee": None})


def test_numbered_from_one_is_said(path):
    tables.written(path, {"t": [0, 1, 2, 3], **{f"q{k + 1}": Q[:, k] for k in range(3)}})
    with pytest.warns(TraceNote, match=naming("'q1'", "'q3'")):
        assert logs.read(path, wanted={"q": 3})["q"].tolist() == Q.tolist()


@pytest.mark.parametrize(
    ("names", "wanted", "facts"),
    [
        (["q_0", "q_2"], {"q": 2}, ["q_0", "q_2"]),
        (["q_0", "q_1"], {"q": 3}, ["'q'", "3"]),
        (["q_0", "q_1", "q.0", "q.1"], {"q": 2}, ["'q'", "several"]),
        (["q_0", "q_1"], {"q": None}, ["'q'", "one number"]),
    ],
)
def test_vectors_that_cannot_be_made(path, names, wanted, facts):
    tables.written(path, {"t": [0, 1, 2, 3], **dict.fromkeys(names, V)})
    with pytest.raises(TraceError, match=naming(*facts)):
        logs.read(path, wanted=wanted)


def test_a_map_that_gives_too_few_components(path):
    tables.write(path, t=[0, 1, 2, 3], a=V, b=V)
    with pytest.raises(TraceError, match=naming("q[1]")):
        logs.read(path, {"q[0]": "a", "q[2]": "b"}, {"q": 3})
    with pytest.raises(TraceError, match="'x'"):
        logs.read(path, {"q[x]": "a"}, {"q": 1})


def test_other_lengths_and_shapes_stop_only_who_reads_them(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(
        path, t=[0, 1], v=[1, 2], rate=50.0, name="run 7", short=[1], cube=np.zeros((2, 2, 2)), z=[1j, 2]
    )
    assert logs.read(path, wanted=["v"])["v"].tolist() == [1, 2]
    for name in ("rate", "short", "cube", "z"):
        with pytest.raises(TraceError, match=f"'{name}'"):
            logs.read(path, wanted=[name])


def test_fields_of_structures_and_other_types_of_parquet(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    stamps = [{"stamp": {"sec": int(t // 10**9), "nanosec": int(t % 10**9)}, "frame": "odom"} for t in COUNTS]
    zoned = arrow.array(COUNTS // 1000, arrow.timestamp("us", tz="Europe/Rome"))
    clock = arrow.array([0, 500, 1000, 1500], arrow.time32("ms"))
    lists = arrow.array([[1.0, 2.0], None, [3.0, None], [4.0, 5.0]])
    words = arrow.array(["on", "off", None, "on"]).dictionary_encode()
    table = {"header": stamps, "zoned": zoned, "clock": clock, "q": lists, "flag": words, "raw": [b"x"] * 4}
    path = tmp_path / "a.parquet"
    parquet.write_table(arrow.table(table), path)
    trace = logs.read(path, {"t": "header.stamp"}, {"q": 2, "flag": None})
    assert trace.times.tolist() == EXACT
    assert str(trace["q"].tolist()) == "[[1.0, 2.0], [nan, nan], [3.0, nan], [4.0, 5.0]]"
    assert str(trace["flag"].tolist()) == "[1.0, 0.0, nan, 1.0]"
    assert logs.read(path, {"t": "zoned"}, ["q"]).times.tolist() == [0, 0.02, 0.04, 0.06]
    assert logs.read(path, {"t": "clock"}, ["q"]).times.tolist() == [0, 0.5, 1, 1.5]
    with pytest.raises(TraceError, match=naming("'raw'", "binary")):
        logs.read(path, {"t": "clock"}, ["raw"])


def test_a_channel_of_durations_is_in_seconds(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, t=[0, 1], delay=np.array([5, 7], "m8[ms]"), day=np.array(["2024-01-01"] * 2, "M8[D]"))
    trace = logs.read(path, wanted=["delay"])
    assert trace["delay"].tolist() == [0.005, 0.007]
    assert trace.units["delay"] == "s"
    with pytest.raises(TraceError, match=naming("'day'", "dates")):
        logs.read(path, wanted=["day"])


def test_vectors_of_one_component_are_numbers_and_the_other_way_round(path):
    if not typed(path):
        pytest.skip("CSV has no such columns")
    tables.write(path, t=np.array([[0.0], [1.0]]), v=np.array([[5.0], [6.0]]), w=[7.0, 8.0])
    trace = logs.read(path, wanted={"v": None, "w": 1})
    assert trace.times.tolist() == [0, 1]
    assert trace["v"].tolist() == [5, 6]
    assert trace["w"].tolist() == [[7], [8]]


def test_a_number_that_no_float_holds_is_no_number(path):
    tables.write(path, t=[0, 1], v=["1", "1e999"])
    with pytest.raises(TraceError, match=naming("v", "'1e999'")):
        logs.read(path, wanted=["v"])


@pytest.mark.parametrize("name", ["v (cm/s)", "v[cm/s]"])
def test_a_unit_in_other_brackets_is_a_unit(path, name):
    tables.written(path, {"t[ms]": [0, 1], name: [5, 6], "w (raw)": [1, 2]})
    trace = logs.read(path, wanted=["v"])
    assert (trace["v"].tolist(), trace.times.tolist(), trace.units["v"]) == ([5, 6], [0, 0.001], "cm/s")
    with pytest.raises(TraceError, match="'w'"):
        logs.read(path, wanted=["w"])


def test_the_halves_of_times_are_proposed(path):
    tables.written(path, {"stamp.sec": [0, 1], "stamp.nanosec": [0, 0], "v": V[:2]})
    with pytest.raises(TraceError, match=r"--map t=stamp$"):
        logs.read(path, wanted=["v"])


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    unit=st.sampled_from(["ns", "us", "ms"]),
    first=st.integers(0, 2 * 10**9),
    steps=st.lists(st.integers(1, 10**10), min_size=1, max_size=5),
)
def test_counts_of_any_unit_are_the_seconds_that_they_are(path, unit, first, steps):
    """Correctly rounded: of the counts themselves, or of their differences where they are dates."""
    size = {"ns": Fraction(1, 10**9), "us": Fraction(1, 10**6), "ms": Fraction(1, 1000)}[unit]
    counts = first * int(1 / size) + np.cumsum([0, *steps])
    tables.write(path, t=counts, v=np.zeros(len(counts)))
    times = logs.read(path, wanted=["v"], time_unit=unit).times
    start = int(counts[0]) if first >= 10**8 or times[0] == 0 else 0
    assert times.tolist() == [float((int(count) - start) * size) for count in counts]
    tables.write(path, t=counts.astype(f"M8[{unit}]"), v=np.zeros(len(counts)))
    dates = logs.read(path, wanted=["v"]).times
    assert dates.tolist() == [float((int(count) - int(counts[0])) * size) for count in counts]


@pytest.mark.parametrize("stamps", [[0.0, float("inf")], [float("-inf"), 0.0], [1e300, 0.0], [0.0, -1e300]])
@pytest.mark.parametrize("unit", [None, "ns", "h"])
def test_stamps_that_are_no_times(path, stamps, unit):
    tables.write(path, t=stamps, v=V[:2])
    with pytest.raises(TraceError, match="time"):
        logs.read(path, wanted=["v"], time_unit=unit)


def test_an_unnamed_first_column_has_the_name_that_pandas_gives_it(tmp_path):
    path = tmp_path / "frame.csv"
    path.write_text(",v\n0,1\n0.1,1\n0.2,3\n")
    with pytest.raises(TraceError, match="Unnamed: 0"):
        logs.load(path, {}, {"v": None})
    assert logs.load(path, {"t": "Unnamed: 0"}, {"v": None}).trace.times.tolist() == [0.0, 0.1, 0.2]


def test_days_in_the_name_of_the_times_are_days(tmp_path):
    path = tmp_path / "days.csv"
    path.write_text("time_days,v\n0,1\n0.5,1\n1,3\n")
    assert logs.load(path, {"t": "time_days"}, {"v": None}).trace.times.tolist() == [0.0, 43200.0, 86400.0]


@pytest.mark.parametrize("first", [133_000_000_000_000_000, 638_000_000_000_000_000])
def test_counts_of_100_nanoseconds_are_not_taken_for_nanoseconds(tmp_path, first):
    path = tmp_path / "counts.csv"
    path.write_text("".join(["time,v\n", *(f"{first + k * 10**6},1\n" for k in range(5))]))
    with pytest.raises(TraceError, match="state their --time-unit"):
        logs.load(path, {"t": "time"}, {"v": None})


def test_a_message_that_names_one_joint_twice_is_refused():
    message = SimpleNamespace(name=["hip", "knee", "hip"], position=[1.0, 2.0, 3.0])
    assert Element("name", "position", "knee")(message) == 2.0
    with pytest.raises(TraceError, match="hip"):
        Element("name", "position", "hip")(message)
