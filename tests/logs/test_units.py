"""Units in names and attributes of real logs: each is used or refused, and one that ``--map`` states overrides it."""

import io
import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.io

import s2r_spec as s2r
from s2r_spec import logs
from s2r_spec.errors import TraceError, TraceNote, UsageError
from s2r_spec.logs.formats.follow import follow
from s2r_spec.logs.mapping import ColumnRequest
from s2r_spec.recordings.log_episodes import EpisodeSettings, read_log_episodes
from s2r_spec.recordings.recorded import LogBackend
from tests.errors import naming, states
from tests.logs import tables

TIMES = [0.0, 0.1]
HEIGHT = s2r.parse_spec("signal h {m}\nrequire r: always (h >= 20)")


@pytest.fixture(params=[*tables.ENDINGS, ".h5", ".mat"])
def path(request, tmp_path):
    return tmp_path / f"log{request.param}"


def written(path, columns):
    """Write columns as a file of the format that its ending says; MATLAB's names have no brackets."""
    if path.suffix == ".h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file[name.replace("/", "∕")] = values
    elif path.suffix == ".mat":
        scipy.io.savemat(path, columns)
    else:
        tables.written(path, columns)
    return path


def rho(path, column, text="signal h {m}\nrequire r: always (h >= 20)"):
    trace = logs.load(path, {"h": column}, {"h": None}).trace
    return s2r.parse_spec(text).robustness(trace)["r"]


@pytest.mark.parametrize("name", ["ascent(feet)", "ascent (feet)", "ascent[feet]", "ascent [feet]"])
def test_the_unit_in_a_name_is_used_whatever_the_map_says(path, name):
    if path.suffix == ".mat":
        pytest.skip("names of MATLAB have no brackets")
    written(path, {"t": TIMES, name: [48.0, 58.0]})
    for column in (name, "ascent"):
        assert rho(path, column) == pytest.approx(48 * 0.3048 - 20)
        assert rho(path, f"{column} [m]") == 28  # stated, so that the file's text counts no more
    own = logs.load(path, None, {"ascent": None}).trace
    assert own.units == {"ascent": "feet"}


@pytest.mark.parametrize(
    ("name", "unit", "value"),
    [("v(m/s)", "m/s", 1), ("v(km/h)", "m/s", 1 / 3.6), ("AccX(g)", "m/s^2", 9.80665), ("a (mg)", "cm/s^2", 0.980665),
     ("temp(C)", "K", 274.15), ("temp (F)", "degC", (1 - 32) / 1.8), ("w(°/s)", "rad/s", np.pi / 180),
     ("n (RPM)", "rpm", 1), ("duty (%)", "%", 1), ("a(m/s²)", "cm/s^2", 100), ("m (g)", "kg", 0.001)],
)  # fmt: skip
def test_units_of_real_headers(tmp_path, name, unit, value):
    path = tables.written(tmp_path / "log.csv", {"t": TIMES, name: [1, 1]})
    spec = f"signal h {{{unit}}}\nrequire r: always (h >= 0)"
    assert rho(path, name, spec) == pytest.approx(value)


@pytest.mark.parametrize(
    "names",
    [
        ["q_0(deg)", "q_1(deg)"],
        ["q0 [deg]", "q1 [deg]"],
        ["q[0] (deg)", "q[1] (deg)"],
        ["q (deg)[0]", "q (deg)[1]"],
    ],
)
def test_components_of_vectors_have_units_in_their_names(tmp_path, names):
    path = tables.written(tmp_path / "log.npz", {"t": TIMES, names[0]: [180, 0], names[1]: [0, 180]})
    table = tables.written(tmp_path / "log.csv", {"t": TIMES, names[0]: [180, 0], names[1]: [0, 180]})
    spec = s2r.parse_spec("signal q[2] {rad}\nrequire r: always (norm(q) <= 4)")
    parts = {"q[0]": names[0], "q[1]": names[1]}
    for log in (path, table):
        if log is path and names[0].endswith("[0]"):
            continue  # the numbers of components are part of a name in CSV alone
        for columns in ({}, parts, {"q": "q [deg]"}):
            trace = logs.load(log, columns, {"q": 2}).trace
            assert spec.robustness(trace)["r"] == pytest.approx(4 - np.pi)


def test_a_unit_of_another_dimension_is_refused_with_a_way_out(tmp_path):
    path = tables.written(tmp_path / "log.csv", {"t": TIMES, "v(t)": [5, 5], "w [raw]": [5, 5]})
    for column, unit in (("v(t)", "t"), ("w", "raw")):
        with pytest.raises(TraceError, match=naming("'h'", unit, "[m]")):
            rho(path, column)
        assert rho(path, f"{column} [m]") == -15


def test_two_columns_of_one_name_and_several_units_are_a_question(tmp_path):
    path = tables.written(tmp_path / "log.csv", {"t": TIMES, "v (m/s)": [5, 5], "v (km/h)": [18, 18]})
    with pytest.raises(TraceError, match=naming("v (m/s)", "v (km/h)")):
        logs.load(path, None, {"v": None})
    assert logs.load(path, {"v": "v (km/h)"}, {"v": None}).trace.units == {"v": "km/h"}


@pytest.mark.parametrize(("name", "said"), [("gyro (raw)", True), ("gyro(axis x)", True), ("gyro[0]", False)])
def test_a_text_in_brackets_that_is_no_unit_gets_a_note(tmp_path, name, said):
    path = tables.written(tmp_path / "log.csv", {"t": TIMES, name: [48, 58], "state (0=off)": [0, 1]})
    spec = s2r.parse_spec("signal h {m}\nsignal s\nrequire r: always (h >= 20 and s >= 0)")
    columns = {"h": name, "s": "state (0=off)"}
    found = read_log_episodes(
        path, spec.signals, {"h": None, "s": None}, spec.horizon(), EpisodeSettings(columns)
    )
    assert [states(note, name, "m", "h") for note in found.notes] == [True] * said
    stated = EpisodeSettings({**columns, "h": f"{name} [m]"})
    assert not read_log_episodes(path, spec.signals, {"h": None, "s": None}, spec.horizon(), stated).notes


@pytest.mark.parametrize(("written_unit", "stated", "noted"), [
    ("m/s²", "m/s^2", False), ("m/s^2", "m/s²", False), ("g", "m/s^2", True), ("raw", "m/s^2", True), ("mm", "-", True),
])  # fmt: skip
def test_a_stated_unit_overrides_and_says_so(tmp_path, written_unit, stated, noted):
    path = tables.written(tmp_path / "log.csv", {"t": TIMES, f"a [{written_unit}]": [1, 1]})
    found = logs.load(path, {"a": f"a [{stated}]"}, {"a": None})
    assert found.trace.units == {"a": stated}
    assert [states(note, "a", stated, written_unit) for note in found.notes] == [True] * noted


def test_a_stated_text_must_be_a_unit(tmp_path):
    path = tables.written(tmp_path / "log.csv", {"t": TIMES, "a": [1, 1]})
    with pytest.raises(TraceError, match=naming("fett", "a")):
        logs.load(path, {"a": "a [fett]"}, {"a": None})


def test_rows_of_standard_input_are_read_in_the_unit_of_their_header():
    for name, column, unit in (
        ("ascent(feet)", "ascent(feet)", "feet"),
        ("ascent (feet)", "ascent [m]", "m"),
    ):
        stream = io.StringIO(f"t,{name}\n0,48\n0.1,58\n")
        rows = follow(stream.readline, ColumnRequest({"h": column}, {"h": None}))
        assert rows.units == {"h": unit}
        assert [sample["h"] for _, sample in rows.samples] == [48, 58]


def test_data_frames_have_units_in_their_names():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"t": TIMES, "ascent(feet)": [48.0, 58.0], "state (raw)": [1, 2]})
    trace = s2r.Trace.from_dataframe(frame)
    assert trace.units == {"ascent(feet)": "feet"}
    assert HEIGHT.robustness(trace.rename({"ascent(feet)": "h"}))["r"] == pytest.approx(48 * 0.3048 - 20)
    stated = s2r.Trace.from_dataframe(frame, units={"ascent(feet)": "m"})
    assert stated.units == {"ascent(feet)": "m"}


# -- attributes of HDF5, texts of MATLAB -----------------------------------------------------------------------------


def hdf5(path, unit, times="seconds since 1970-01-01"):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["arm/time"] = TIMES
        file["arm/time"].attrs["units"] = times
        file["arm/gap"] = [700.0, 900.0]
        file["arm/gap"].attrs["units"] = h5py.Empty("S1") if unit is None else unit
    return path


GAP = "signal h {m}\nrequire r: always (h >= 0.7)"


@pytest.mark.parametrize(
    "times", ["seconds since 1970-01-01", "s", np.bytes_(b"seconds since 1970-01-01 00:00")]
)
@pytest.mark.parametrize(
    "unit",
    ["mm", np.bytes_(b"mm"), np.array(b"mm\0\0", dtype="S4"), np.array([b"mm"]), np.array(["mm"], dtype=object),
     np.array([b"mm"], dtype=object), np.bytes_(b" mm "), np.array([["mm"]], dtype=object)],
    ids=str,
)  # fmt: skip
def test_a_unit_of_hdf5_is_a_text_of_any_kind(tmp_path, unit, times):
    path = hdf5(tmp_path / "log.h5", unit, times)
    assert rho(path, "arm.gap", GAP) == 0
    assert logs.load(path).trace.times.tolist() == TIMES


def test_an_empty_unit_of_hdf5_states_none(tmp_path):
    for unit in (None, "", np.bytes_(b"\0")):
        assert logs.load(hdf5(tmp_path / "log.h5", unit)).trace.units == {}


@pytest.mark.parametrize(
    "unit", [np.bytes_(b"\xb0C"), np.array([b"mm", b"deg"]), np.array([1.5, 2.5])], ids=str
)
def test_a_unit_of_hdf5_that_is_no_text_is_refused_by_name(tmp_path, unit):
    path = hdf5(tmp_path / "log.h5", unit)
    with pytest.raises(TraceError, match=naming("arm.gap")):
        logs.load(path, {"h": "arm.gap"}, {"h": None})
    assert rho(path, "arm.gap [mm]", GAP) == 0


def test_times_since_two_dates_are_refused(tmp_path):
    path = hdf5(tmp_path / "log.h5", "mm")
    with pytest.importorskip("h5py").File(path, "a") as file:
        file["leg/time"], file["leg/q"] = TIMES, [1.0, 2.0]
        file["leg/time"].attrs["units"] = "days since 2020-01-01"
    with pytest.raises(TraceError, match=naming("1970-01-01", "2020-01-01")):
        logs.load(path, {"h": "arm.gap"}, {"h": None})


@pytest.mark.parametrize(
    "content",
    [{"units": "mm"}, {"unit": "mm"}, {"units": {"gap": "mm"}}],
)
def test_a_text_of_a_structure_of_matlab_is_the_unit_of_its_arrays(tmp_path, content):
    scipy.io.savemat(tmp_path / "log.mat", {"s": {"t": TIMES, "gap": [700.0, 900.0], **content}})
    assert rho(tmp_path / "log.mat", "s.gap", GAP) == 0
    assert rho(tmp_path / "log.mat", "s.gap [cm]", GAP) == pytest.approx(7 - 0.7)


@pytest.mark.parametrize("key", ["Units", "UNIT", "unit"])
def test_an_attribute_of_hdf5_states_the_unit_in_any_case(key, tmp_path):
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as stream:
        stream["t"], stream["gap"] = np.arange(5) * 0.1, np.full(5, 320.0)
        stream["gap"].attrs[key] = np.array([b"mm", b"mm"])
    assert logs.load(tmp_path / "log.h5", None, {"gap": None}).trace.units["gap"] == "mm"


def test_packed_numbers_of_netcdf_are_unpacked(tmp_path):
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as stream:
        stream["t"], stream["gap"] = np.arange(3) * 0.1, np.array([320, -9999, 400])
        stream["gap"].attrs.update({"scale_factor": 0.001, "_FillValue": -9999, "units": "m"})
    found = logs.load(tmp_path / "log.h5", None, {"gap": None}).trace["gap"]
    assert found == pytest.approx([0.32, np.nan, 0.4], nan_ok=True)


def test_the_metadata_of_a_parquet_field_state_its_unit(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    field = pa.field("v", pa.float64(), metadata={"unit": "mm/s"})
    table = pa.table([[0.0, 0.1], [500.0, 500.0]], schema=pa.schema([pa.field("t", pa.float64()), field]))
    pq.write_table(table, tmp_path / "log.parquet")
    assert logs.load(tmp_path / "log.parquet", None, {"v": None}).trace.units["v"] == "mm/s"


def test_a_name_that_ends_in_another_unit_is_refused_until_the_unit_is_stated(tmp_path):
    (tmp_path / "log.csv").write_text("t,pitch_deg\n0,45\n0.1,45\n")
    spec = s2r.parse_spec("signal pitch {rad}\nrequire r: always (pitch <= 1)")
    for column, refused in (("pitch_deg", True), ("pitch_deg [deg]", False)):
        read = EpisodeSettings({"pitch": column})
        if refused:
            with pytest.raises(TraceError, match="pitch_deg"):
                read_log_episodes(tmp_path / "log.csv", spec.signals, {"pitch": None}, spec.horizon(), read)
        else:
            found = read_log_episodes(
                tmp_path / "log.csv", spec.signals, {"pitch": None}, spec.horizon(), read
            )
            assert spec.robustness(found.episodes[0].trace)["r"] == pytest.approx(1 - np.deg2rad(45))


def test_minutes_in_the_name_of_the_times_are_minutes(tmp_path):
    (tmp_path / "log.csv").write_text("time_minutes,v\n0,1\n1,1\n2,1\n")
    assert logs.load(tmp_path / "log.csv", {"t": "time_minutes"}, {"v": None}).trace.times[-1] == 120.0


@pytest.mark.parametrize("unit", ["%", "deg", "mrad"])
def test_a_unit_that_the_specification_does_not_declare_converts_nothing(unit):
    trace = s2r.Trace(range(3), {"soc": [95, 95, 95]}, {"soc": unit})
    with pytest.raises(TraceError, match=naming("soc", unit)):
        s2r.parse_spec("signal soc\nrequire r: always soc <= 80").satisfied(trace)
    assert s2r.parse_spec("signal soc\nrequire r: soc <= 80").satisfied(replace(trace, units={"soc": "rad"}))


def test_two_units_of_one_dataset_are_no_unit(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["v"] = np.arange(5.0) / 10, np.ones(5)
        file["v"].attrs["unit"], file["v"].attrs["units"] = "m/s", "km/h"
    spec = s2r.parse_spec("signal v {m/s}\nrequire r: always v <= 2")
    with (
        warnings.catch_warnings(action="ignore", category=TraceNote),
        pytest.raises(TraceError, match="v"),
    ):
        spec.satisfied(s2r.read_trace(tmp_path / "a.h5"))


@pytest.mark.parametrize(("size", "name"), [(1000.0, "time"), (200.0, "t"), (1 / 86400, "when")])
def test_recordings_whose_times_have_no_unit_are_no_certificate(size, name, tmp_path):
    head = "certify r: delta = 1e-3, epsilon = 0.5, B = 8, R = 0.05, kernel = matern52(1), fall = -1"
    spec = s2r.parse_spec(
        f"signal v {{m/s}}\nparam vd in [0, 1]\nrequire r: always abs(deriv(v)) <= 2 {{m/s^2}}\n{head}\n"
    )
    rows = "".join(f"{(k / 50) * size},{0.3 if k < 20 else -0.7}\n" for k in range(40))
    for k in range(8):
        (tmp_path / f"r{k}.csv").write_text(f"{name},v\n{rows}{(40 + k) / 50 * size},0\n")
    (tmp_path / "rollouts.csv").write_text("id,vd\n" + "".join(f"r{k},{k / 8}\n" for k in range(8)))
    with (
        warnings.catch_warnings(action="ignore", category=TraceNote),
        pytest.raises(UsageError, match=naming("deriv", "time-unit")),
    ):
        s2r.check(spec, LogBackend(f"{tmp_path}?map=t={name}"), tmp_path / "run")
