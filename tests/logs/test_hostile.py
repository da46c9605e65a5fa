"""Files that would take all memory, or for ever: one sentence, at once."""

import os
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from s2r_spec import logs
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.logs.table import MOST_COLUMNS, MOST_NUMBERS
from s2r_spec.spec import load_spec
from tests.errors import naming
from tests.logs import fuzz, tables


def header(shape: object, descr: str = "'<f8'") -> bytes:
    """Return the head of an .npy file."""
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}".encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return path


T, V = (header((3,)) + np.arange(3.0).tobytes() for _ in "tv")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
@pytest.mark.parametrize("ending", [*tables.ENDINGS, ".stl"])
def test_what_is_no_file(tmp_path, ending, kind):
    path = tmp_path / f"a{ending}"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    with pytest.raises(UsageError, match=str(path)):
        load_spec(path) if ending == ".stl" else logs.read(path)


def test_a_spec_that_imports_what_never_ends(tmp_path):
    path = tmp_path / "a.stl"
    path.write_text('import "/dev/zero"\nsignal v\nrequire a: always v > 0\n')
    with pytest.raises(UsageError, match=naming(f"{path}:1:8", "/dev/zero")):
        load_spec(path)
    path.write_bytes(b"# " + b"x" * 2**19)
    with pytest.raises(UsageError, match=str(path)):
        load_spec(path)
    for number in range(60):
        (tmp_path / f"{number}.stl").write_text(f'import "{number + 1}.stl"\nsignal v{number}\n')
    with pytest.raises(UsageError, match=naming("E21", "50")):
        load_spec(tmp_path / "0.stl")


def test_an_array_that_inflates_stops_only_who_reads_it(tmp_path):
    count = MOST_NUMBERS + 1
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, data in {"t": T, "v": V}.items():
            file.writestr(f"{name}.npy", data)
        with file.open("big.npy", "w", force_zip64=True) as stream:
            stream.write(header((count,)))
            for _ in range(0, 8 * count, 2**22):
                stream.write(bytes(2**22))
    assert path.stat().st_size < 2e6
    assert logs.read(path, wanted=["v"])["v"].tolist() == [0, 1, 2]
    with pytest.raises(TraceError, match=naming(str(path), f"{MOST_NUMBERS / 1e6:.0f} million")):
        logs.read(path, wanted=["v", "big"])


@pytest.mark.parametrize(
    "data",
    [
        header((10**12,)) + bytes(24),
        header((-1,)),
        header("'x'"),
        header("(" * 500),
        header((3,), "'<U99999999'"),
        header((3,), "__import__('os')"),
        b"\x93NUMPY\x02\x00\xff\xff\xff\xff",
        b"\x93NUMPY\x09\x00",
        b"",
    ],
)
def test_an_array_whose_head_lies(tmp_path, data):
    path = archive(tmp_path / "a.npz", t=T, v=data)
    with pytest.raises(TraceError, match=str(path)):
        logs.read(path, wanted=["v"])


def test_a_damaged_archive(tmp_path):
    path = archive(tmp_path / "a.npz", t=T, v=V)
    whole = path.read_bytes()
    for place in range(30, len(whole) - 30, 7):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        with suppress(TraceError):
            assert logs.read(path, wanted=["v"])["v"].tolist() == [0, 1, 2]


def test_a_table_of_parquet_that_inflates_or_is_damaged(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    same = arrow.array(np.zeros(2**20))
    groups = MOST_NUMBERS // 2**20 + 1
    with parquet.ParquetWriter(path, arrow.schema([("t", arrow.float64())])) as file:
        for _ in range(groups):
            file.write_table(arrow.table({"t": same}))
    with pytest.raises(TraceError, match=naming(str(path), f"{MOST_NUMBERS / 1e6:.0f} million")):
        logs.read(path)
    parquet.write_table(arrow.table({"t": [0.0, 1.0], "v": [1.0, 2.0]}), path)
    whole = path.read_bytes()
    for place in range(4, len(whole), 23):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        with suppress(TraceError):
            logs.read(path, wanted=["v"])


@pytest.mark.parametrize(
    "text",
    [
        "t,v,a" + " " * 300_000 + "b[\n0,1,2\n",
        "t,v," + "[" * 120_000 + "\n0,1,2\n",
        "t,v," + "[]" * 60_000 + "\n0,1,2\n",
        "t,v," + ",".join(f"c{k}" for k in range(20_000)) + "\n" + ",".join(["0"] * 20_002) + "\n",
    ],
)
def test_long_heads_cost_no_more_than_their_length(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert len(logs.read(path, wanted=["v"])["v"]) == 1
    with pytest.raises(TraceError) as caught:
        logs.read(path, wanted=["speed"])
    assert len(str(caught.value)) < 2000


def test_a_table_that_is_nothing_but_names_or_one_line(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("," * MOST_COLUMNS + "\n")
    with pytest.raises(TraceError, match=naming(str(path), "columns")):
        logs.read(path)
    with path.open("wb") as stream:
        stream.truncate(2**33)
    with pytest.raises(TraceError, match=naming(str(path), "line 1")):
        logs.read(path)


def test_damaged_traces_are_read_or_refused_in_a_sentence(tmp_path):
    assert fuzz.faults(tmp_path, seed=1, count=100) == []
