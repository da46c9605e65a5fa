import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from s2r_spec import logs
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace
from tests.errors import naming
from tests.examples import examples
from tests.logs import tables

ANY_FLOAT = st.floats(width=64)
INSTALLED = [ending for ending in logs.FORMATS if ending != ".parquet" or find_spec("pyarrow")]
META = st.dictionaries(
    st.text(max_size=5), st.one_of(st.integers(), st.text(max_size=5), st.none()), max_size=3
)


def same(left: Trace, right: Trace) -> bool:
    return (
        left.times.tobytes() == right.times.tobytes()
        and {k: (v.shape, _bits(v)) for k, v in left.channels.items()}
        == {k: (v.shape, _bits(v)) for k, v in right.channels.items()}
        and dict(left.units) == dict(right.units)
        and dict(left.meta) == dict(right.meta)
    )


def _bits(values: np.ndarray) -> bytes:
    # one NaN for all: text has no payload
    return np.where(np.isnan(values), np.nan, values).tobytes()


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    n = draw(st.integers(1, 5))
    times = sorted(draw(st.sets(st.floats(-1e9, 1e9), min_size=n, max_size=n)))
    shape = st.sampled_from([(n,), (n, 1), (n, 3)])
    names = draw(st.lists(st.sampled_from(["vx", "file", "a b", "q_1", "ω,x", "x.npy"]), unique=True))
    channels = {name: draw(arrays(np.float64, draw(shape), elements=ANY_FLOAT)) for name in names}
    units = {name: draw(st.sampled_from(["m/s", "", "1", "N*m"])) for name in names if draw(st.booleans())}
    return Trace(times, channels, units, draw(META))


@pytest.mark.parametrize("ending", INSTALLED)
@settings(
    max_examples=examples(80), suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
@given(trace=traces())
def test_what_is_written_is_read_back_bit_for_bit(tmp_path: Path, ending: str, trace: Trace) -> None:
    path = tmp_path / f"trace{ending}"
    logs.write(trace, path)
    assert same(logs.read(path), trace)


def test_a_foreign_csv(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("\ufefft,vx [m/s],u[1] [V],u[0] [V]\r\n0,1,2,3\r\n0.5,4,5,6\r\n\r\n".encode())
    trace = logs.read(path)
    assert trace.times.tolist() == [0, 0.5]
    assert trace["vx"].tolist() == [1, 4]
    assert trace["u"].tolist() == [[3, 2], [6, 5]]
    assert dict(trace.units) == {"vx": "m/s", "u": "V"}


def test_a_foreign_npz(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, t=[0, 1], vx=[1, 2])
    trace = logs.read(path)
    assert trace["vx"].tolist() == [1, 2]
    assert dict(trace.units) == {}


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        ("", ["empty", "first line"]),
        ("# a comment\n\n", ["empty"]),
        ("time,v\n0,1\n", ["'t'", "time, v", "--map t=time"]),
        ("t,t,v\n0,1,2\n", ["2 columns", "'t'"]),
        ("t;v\n0;1,5\n", ["';'"]),
        ("t,v\n0,1_000\n", ["line 2, column 2 (v)", "'1_000'"]),
        ("t [m],v\n1,2\n", ["'m'", "t [ms]"]),
        ("t,v\n0,1\n1\n2,2\n", ["line 3", "1", "2"]),
        ("t,v\n0,1\n1,2,3\n", ["line 3", "3", "2"]),
        ("t,v\n0,1\n1,x\n", ["line 3, column 2 (v)", "'x'"]),
        ('# s2r {"meta": {}}\n# more\nt,v\n0,1\n1,x\n', ["line 5, column 2 (v)", "'x'"]),
        ("t,v\n0,1\n,2\n", ["line 3, column 1 (t)", "no time"]),
        ("t,v,v\n0,1,2\n", ["2 columns", "'v'"]),
        ("t,v[0],v[2]\n0,1,2\n", ["v[0]", "v[1]"]),
        ("t,v[0] [m],v[1] [s]\n0,1,2\n", ["'v'", "units"]),
        ("t,w\n0,1\n", ["'v'", "w"]),
        ("t,v\n", ["no samples"]),
        ("t,v\n1,0\n0,0\n", ["line 3", "0 s", "1 s"]),
        ("# s2r {}\nt,v\n1,1\n", ["line 1", "meta"]),
        ('# s2r {"meta": 3}\nt,v\n1,1\n', ["line 1", "meta"]),
        ("# s2r " + "[" * 99999 + "\nt,v\n1,1\n", ["line 1", "meta"]),
        ('t,v\n0,"1\n', ["comma-separated"]),
        ("t\0,v\n0,1\n", ["UTF-8"]),
        ("t,v,v [" + "m*" * 90 + "m]\n0,1,2\n", ["2 columns", "'v'"]),
        ("t,v [" + "m*" * 90 + "m]\n0,1\n", ["'v'", "unit"]),
    ],
)
def test_a_bad_csv_names_the_place(tmp_path: Path, text: str, facts: list[str]) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(TraceError, match=naming(str(path), *facts)) as caught:
        logs.read(path, wanted=["v"])
    assert caught.value.exit_code == 2
    assert len(str(caught.value)) < 400 + len(str(path))


@pytest.mark.parametrize("ending", INSTALLED)
def test_the_times_may_have_another_name(tmp_path: Path, ending: str) -> None:
    path = tables.write(tmp_path / f"a{ending}", t=[9, 9], time=[0, 0.5], v=[1, 2])
    trace = logs.read(path, {"t": "time", "x": "v"})
    assert trace.times.tolist() == [0, 0.5]
    assert {name: values.tolist() for name, values in trace.channels.items()} == {"t": [9, 9], "x": [1, 2]}
    with pytest.raises(TraceError, match=naming("'stamp'", "t, time, v")):
        logs.read(path, {"t": "stamp"})


def test_a_bad_npz_says_so(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    path.write_bytes(b"not a zip")
    with pytest.raises(TraceError, match=naming(str(path), ".npz")):
        logs.read(path)
    np.savez(path, v=[1])
    with pytest.raises(TraceError, match=naming(str(path), "'t'", "v")):
        logs.read(path)
    np.savez(path, t=[0], v=np.array([{}], dtype=object))
    with pytest.raises(TraceError, match=naming("'v'", "objects")):
        logs.read(path, wanted=["v"])


def test_bad_names(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=naming("'.parquetx'", ".csv", ".npz")):
        logs.read(tmp_path / "a.parquetx")
    with pytest.raises(TraceError, match=naming("none.csv", "No such file")):
        logs.read(tmp_path / "none.csv")
    for name in ("t", "u[0]", ""):
        with pytest.raises(TraceError, match=re.escape(repr(name))):
            logs.write(Trace([0], {name: [1]}), tmp_path / "a.csv")
    with pytest.raises(TraceError, match=naming("'t'", ".npz")):
        logs.write(Trace([0], {"t": [1]}), tmp_path / "a.npz")
    with pytest.raises(TraceError, match=naming(str(tmp_path / "no" / "a.npz"), "No such file")):
        logs.write(Trace([0], {}), tmp_path / "no" / "a.npz")
