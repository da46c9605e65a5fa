"""A folder of recorded rollouts: what it offers, and one sentence for each way in which it can be wrong."""

from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.backend import Backend, HasRecordings
from s2r_spec.errors import TraceNote, UsageError
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.runs.compatibility import check_compatibility
from tests.errors import naming

TIMES = np.arange(4) / 10


def trace(level: float, **changes) -> s2r.Trace:
    settings = {"channels": {"vx": level + 0 * TIMES}, "units": {"vx": "m/s"}} | changes
    return s2r.Trace(TIMES, settings["channels"], settings["units"])


def write(folder: Path, table: str, **traces: s2r.Trace) -> str:
    """Write a folder: ``a_npz=trace`` is the file a.npz."""
    folder.mkdir(exist_ok=True)
    (folder / "rollouts.csv").write_text(table)
    for name, one in traces.items():
        s2r.write_trace(one, folder / name.replace("_", "."))
    return str(folder)


TABLE = "id,vd [m/s],load [kg],seed\na,0.1,2,7\nb,0.1,2,8\nc,-0.2,2,9\n"


@pytest.fixture
def folder(tmp_path) -> str:
    return write(tmp_path / "log", TABLE, a_npz=trace(1.0), b_csv=trace(2.0), c_npz=trace(3.0))


def test_what_a_folder_offers(folder):
    backend = s2r.load_backend(f"log:{folder}")
    assert isinstance(backend, Backend)
    assert isinstance(backend, HasRecordings)
    assert backend.name == f"log:{folder}"
    assert [(c.name, c.unit, c.width) for c in backend.channels] == [("vx", "m/s", 1)]
    assert [(p.name, p.unit, p.low, p.high) for p in backend.parameters] == [
        ("vd", "m/s", -0.2, 0.1),
        ("load", "kg", 2, 2),
    ]
    assert backend.duration == pytest.approx(0.3)
    assert [params for params, _ in backend.recorded()] == [
        {"vd": 0.1, "load": 2.0},
        {"vd": 0.1, "load": 2.0},
        {"vd": -0.2, "load": 2.0},
    ]
    assert [recorded["vx"][0] for _, recorded in backend.recorded()] == [1, 2, 3]


def test_the_seed_chooses_among_what_was_recorded_at_a_test_and_nothing_else(folder):
    backend = LogBackend(folder)
    levels = [backend.rollout({"vd": 0.1, "load": 2}, seed)["vx"][0] for seed in range(4)]
    assert levels == [1, 2, 1, 2]
    assert backend.rollout({"vd": -0.2}, 5)["vx"][0] == 3
    with pytest.raises(UsageError, match=naming("vd = 0.15", "vd = -0.2, load = 2", "vd = 0.1, load = 2")):
        backend.rollout({"vd": 0.15}, 0)


def test_the_hash_is_of_everything_in_the_folder(folder):
    before = LogBackend(folder).model_hash
    assert LogBackend(folder).model_hash == before
    s2r.write_trace(trace(1.5), Path(folder) / "a.npz")
    other = LogBackend(folder).model_hash
    (Path(folder) / "rollouts.csv").write_text(TABLE.replace("-0.2", "-0.1"))
    assert len({before, other, LogBackend(folder).model_hash}) == 3


def test_parquet_and_vectors(tmp_path):
    pytest.importorskip("pyarrow")
    forces = trace(1.0, channels={"f": np.ones((4, 3))}, units={"f": "N"})
    backend = LogBackend(write(tmp_path / "log", "id,vd\na,0.1\n", a_parquet=forces))
    assert [(c.name, c.unit, c.width) for c in backend.channels] == [("f", "N", 3)]


GOOD = {"a_npz": trace(1.0), "b_csv": trace(2.0)}


@pytest.mark.parametrize(
    ("table", "traces", "facts"),
    [
        ("id,vd\n", {}, ["rollouts.csv", "id,<parameter>,…"]),
        ("name,vd\na,1\nb,2\n", GOOD, ["rollouts.csv, line 1", "'name,vd'", "'id'"]),
        ("id,vd,vd\na,1,1\nb,2,2\n", GOOD, ["rollouts.csv, line 1", "'id,vd,vd'"]),
        ("id,vd\na,1\nb\n", GOOD, ["rollouts.csv, line 3", "1", "2"]),
        ("id,vd\na,1\n\nb,fast\n", GOOD, ["rollouts.csv, line 4", "'vd'", "'fast'"]),
        ("id,vd\na,1\nb,nan\n", GOOD, ["rollouts.csv, line 3", "'vd'", "'nan'"]),
        ("id,vd\na,1\nb,\n", GOOD, ["rollouts.csv, line 3", "'vd'", "empty"]),
        ("id,vd\na,1\na,2\nb,3\n", GOOD, ["rollouts.csv, line 3", "'a'", "line 2"]),
        ("id,vd\na,1\nb,2\nz,3\n", GOOD, ["rollouts.csv, line 4", "'z'", "z.csv", "z.npz", "z.parquet"]),
        (
            "id,vd\na,1\n",
            {"a_npz": trace(1.0), "a_csv": trace(2.0)},
            ["rollouts.csv, line 2", "'a'", "a.csv", "a.npz"],
        ),
        ("id,vd\na,1\n", GOOD, ["b.csv", "rollouts.csv"]),
        (
            "id,vd\na,1\nb,2\n",
            {"a_npz": trace(1.0), "b_csv": trace(1.0)},
            ["b.csv", "{folder}/a.npz", "same"],
        ),
        (
            "id,vd\na,1\nb,2\n",
            {"a_npz": trace(1.0), "b_csv": trace(2.0, units={})},
            ["b.csv, line 1", "'vx'", "no unit", "{folder}/a.npz", "vx [m/s]"],
        ),
        (
            "id,vd\na,1\nb,2\n",
            {"a_npz": trace(1.0), "b_csv": trace(2.0, units={"vx": "cm/s"})},
            ["b.csv, line 1", "'vx'", "cm/s", "m/s", "{folder}/a.npz"],
        ),
        (
            "id,vd\na,1\nb,2\n",
            {"a_npz": trace(1.0), "b_csv": trace(2.0, channels={"vy": TIMES}, units={})},
            ["b.csv", "'vx'", "{folder}/a.npz"],
        ),
        (
            "id,vd\na,1\nb,2\n",
            {"a_npz": trace(1.0), "b_csv": trace(2.0, channels={"vx": np.ones((4, 2))})},
            ["b.csv", "'vx'", "{folder}/a.npz"],
        ),
    ],
)
def test_a_bad_folder_gets_one_sentence_with_file_and_line(tmp_path, table, traces, facts):
    folder = write(tmp_path / "log", table, **traces)
    where = [fact.format(folder=folder) for fact in (str(tmp_path), *facts)]
    with pytest.raises(UsageError, match=naming(*where)) as info:
        s2r.load_backend(f"log:{folder}")
    assert info.value.exit_code == 2
    assert len(str(info.value).splitlines()) == 1


def test_no_folder_no_table_and_a_file_that_is_no_trace(tmp_path):
    with pytest.raises(UsageError, match="log:FOLDER"):
        s2r.load_backend("log")
    with pytest.raises(UsageError, match=naming(f"{tmp_path}/nowhere", "rollouts.csv")):
        s2r.load_backend(f"log:{tmp_path}/nowhere")
    folder = write(tmp_path / "log", "id,vd\na,1\n")
    (tmp_path / "log" / "a.csv").write_text("t,vx\n0,1\n0.1,x\n")
    with pytest.raises(UsageError, match=naming("a.csv", "line 3", "column 2 (vx)", "'x'")):
        s2r.load_backend(f"log:{folder}")


def raw(folder: Path, *texts: str) -> str:
    """Write a folder of CSV files, as another tool would."""
    folder.mkdir()
    rows = "".join(f"{number},{0.1 * number}\n" for number, _ in enumerate(texts))
    (folder / "rollouts.csv").write_text(f"id,vd\n{rows}")
    for number, text in enumerate(texts):
        (folder / f"{number}.csv").write_text(text)
    return str(folder)


def test_columns_of_text_and_numbered_ones(tmp_path):
    one = "t,mode,q_0,q_1,on\n0,walk,1,2,True\n1,walk,3,4,no\n"
    folder = raw(tmp_path / "log", one, one.replace("3,4", "5,6"))
    with pytest.warns(TraceNote, match="'mode'"):
        backend = LogBackend(folder)
    assert {(c.name, c.width) for c in backend.channels} == {("q_0", 1), ("q_1", 1), ("on", 1), ("q", 2)}
    assert backend.recordings[1].trace["q"].tolist() == [[1, 2], [5, 6]]
    assert backend.recordings[0].trace["on"].tolist() == [1, 0]


def test_a_channel_that_one_recording_lacks_stops_only_who_reads_it(tmp_path):
    folder = raw(tmp_path / "log", "t,v,w\n0,1,2\n1,2,3\n", "t,v,w\n0,1,fast\n1,3,4\n")
    with pytest.warns(TraceNote, match="'w'"):
        backend = LogBackend(folder)
    assert check_compatibility(
        s2r.parse_spec("signal v\nrequire a: always v > 0"), "a", backend
    ).channels == ("v",)
    for text, words in {"t,v,w [m]\n0,1,2\n": naming("'w'", "m", "no unit"), "t,v\n0,1\n": "'w'"}.items():
        Path(folder, "1.csv").write_text(text)
        with pytest.warns(TraceNote, match=words):
            assert [c.name for c in LogBackend(folder).channels] == ["v"]
    with pytest.raises(UsageError, match=naming("'w'", "1.csv", "line 2", "'fast'")):
        check_compatibility(s2r.parse_spec("signal w\nrequire a: always w > 0"), "a", backend)


def test_how_the_traces_are_read_follows_the_name(tmp_path):
    folder = raw(tmp_path / "log", "k,x\n0,1\n500,\n", "k,x\n0,2\n500,3\n2,0.")
    with pytest.warns(TraceNote, match=naming("1.csv", "line 4")):
        backend = s2r.load_backend(f"log:{folder}?nan=hold&time-unit=ms&map=t=k&map=v%2Bw=x")
    assert backend.recordings[0].trace.times.tolist() == [0, 0.5]
    assert backend.recordings[0].trace["v+w"].tolist() == [1, 1]
    assert backend.name.startswith(f"log:{folder}?nan=hold")
    for words, facts in {
        "nan=zero": ["nan", "error", "hold"],
        "fill=1": ["nan=hold"],
        "time-unit=m": ["'m'"],
        "map=t": ["--map"],
    }.items():
        with pytest.raises(UsageError, match=naming(*facts)):
            s2r.load_backend(f"log:{folder}?{words}")


def test_a_table_that_is_a_pipe_or_has_a_head_without_end(tmp_path):
    folder = raw(tmp_path / "log", "t,v\n0,1\n1,2\n")
    table = Path(folder) / "rollouts.csv"
    table.write_text("id,vd" + " " * 200_000 + "x[\n0,1\n")
    with pytest.raises(UsageError, match=naming("rollouts.csv", "line 1")):
        LogBackend(folder)
    table.unlink()
    table.symlink_to("/dev/zero")
    with pytest.raises(UsageError, match=naming(str(table))):
        LogBackend(folder)
