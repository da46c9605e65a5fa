import sys
from pathlib import Path

import numpy as np
import pytest

from s2r_spec.errors import TraceError
from s2r_spec.logs import read, write
from s2r_spec.trace import Trace
from tests.errors import naming

TRACE = Trace(
    [0.1, 0.2, 1 / 3],
    {"vx": [0.1, np.nan, -1e-300], "u": [[1, 2], [3, 4], [5, 6]]},
    {"vx": "m/s"},
    {"failure": "fall", "seed": 3},
)


def test_without_pyarrow_it_says_what_to_install(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(TraceError, match=naming("pyarrow", "pip install", "[logs]")):
        write(TRACE, tmp_path / "a.parquet")


def test_what_is_written_is_read_back_bit_for_bit(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    write(TRACE, tmp_path / "a.parquet")
    again = read(tmp_path / "a.parquet")
    assert again.times.tobytes() == TRACE.times.tobytes()
    for name in TRACE.channels:
        assert again[name].tobytes() == TRACE[name].tobytes()
    assert (dict(again.units), dict(again.meta)) == (dict(TRACE.units), dict(TRACE.meta))


def test_tables_of_others(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    parquet.write_table(arrow.table({"t": [0.0, 1.0], "n": [1, 2]}), path)
    assert read(path)["n"].tolist() == [1, 2]
    parquet.write_table(arrow.table({"t": [0.0, 1.0], "n": [1, None]}), path)
    assert np.isnan(read(path)["n"]).tolist() == [False, True]
    parquet.write_table(arrow.table({"t": [0.0, 1.0], "n": [[1], [1, 2]]}), path)
    with pytest.raises(TraceError, match=naming("'n'", "lists")):
        read(path, wanted=["n"])
    parquet.write_table(arrow.table({"time": [0.0]}), path)
    with pytest.raises(TraceError, match=naming("'t'", "time")):
        read(path)
    path.write_bytes(b"no table")
    with pytest.raises(TraceError, match=naming(str(path), "Parquet")):
        read(path)


def test_columns_get_the_names_of_signals(tmp_path: Path) -> None:
    write(TRACE, tmp_path / "a.npz")
    again = read(tmp_path / "a.npz", {"speed": "vx"})
    assert set(again.channels) == {"speed", "u"}
    assert again.units == {"speed": "m/s"}
    with pytest.raises(TraceError, match=naming("'vy'", "u, vx")):
        read(tmp_path / "a.npz", {"speed": "vy"})
