"""Runs of protocols in a folder of recorded rollouts: read with their names, and left out of statements on a spec."""

from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.backend import HasRecordings
from s2r_spec.certify.search.pairing import Pairing
from s2r_spec.errors import TraceNote, UsageError
from s2r_spec.recordings.recorded import LogBackend
from tests.errors import naming

TIMES = np.arange(6) / 10
TABLE = "id,protocol,vd [m/s],amplitude,seed\na,,0.1,,7\nb,,0.3,,8\nc,squat,,0.5,9\nd,squat,,,9\n"
SPEC = """
signal vx {m/s}
param vd {m/s} in [0, 0.4]
require steady: always[0, 0.4 s] (vx >= 0)
certify steady: delta = 0.01, epsilon = 0.5, B = 1, R = 0.1, kernel = matern52(0.3 {m/s}), fall = -1
"""


def trace(level: float, name: str = "vx", **meta) -> s2r.Trace:
    return s2r.Trace(TIMES, {name: level + 0 * TIMES}, {name: "m/s"}, meta)


def write(folder: Path, table: str, **traces: s2r.Trace) -> str:
    folder.mkdir(exist_ok=True)
    (folder / "rollouts.csv").write_text(table)
    for name, one in traces.items():
        s2r.write_trace(one, folder / name.replace("_", "."))
    return str(folder)


@pytest.fixture
def folder(tmp_path) -> str:
    return write(
        tmp_path / "log",
        TABLE,
        a_npz=trace(1.0),
        b_csv=trace(2.0),
        c_csv=trace(3.0, "q", protocol="squat"),
        d_npz=trace(4.0, "dq"),
    )


def test_rows_with_a_protocol_are_runs_of_it_with_channels_and_parameters_of_their_own(folder):
    backend = LogBackend(folder)
    assert isinstance(backend, HasRecordings)
    assert [(r.protocol, dict(r.params)) for r in backend.recordings] == [
        ("", {"vd": 0.1}),
        ("", {"vd": 0.3}),
        ("squat", {"amplitude": 0.5}),
        ("squat", {}),
    ]
    assert list(backend.recordings[2].trace.channels) == ["q"]
    assert [c.name for c in backend.channels] == ["vx"]
    assert [p.name for p in backend.parameters] == ["vd"]
    assert [params for params, _ in backend.recorded()] == [{"vd": 0.1}, {"vd": 0.3}]
    assert backend.rollout({"vd": 0.3}, 5)["vx"][0] == 2


def test_a_log_that_is_cut_into_parts_may_stand_beside_a_whole_run_of_a_protocol(tmp_path):
    write(tmp_path / "log", "id,protocol\na,\nb,squat\n", a_npz=trace(1.0), b_npz=trace(3.0, "q"))
    with pytest.warns(TraceNote, match="2 parts"):
        recordings = LogBackend(f"{tmp_path / 'log'}?every=0.2").recordings
    assert [(r.protocol, r.trace.duration) for r in recordings] == [
        ("", pytest.approx(0.2)),
        ("", pytest.approx(0.2)),
        ("squat", pytest.approx(0.5)),
    ]
    assert [r.params.get("start") for r in recordings] == [0.0, pytest.approx(0.2), None]


def test_the_trace_alone_can_name_its_protocol(tmp_path):
    table = "id,vd\na,0.1\nb,0.2\n"
    traces = {"a_npz": trace(1.0), "b_npz": trace(2.0, protocol="hold")}
    backend = LogBackend(write(tmp_path / "log", table, **traces))
    assert [r.protocol for r in backend.recordings] == ["", "hold"]
    assert backend.parameters[0].high == 0.1


def test_an_older_folder_may_have_a_parameter_of_that_name(tmp_path):
    backend = LogBackend(
        write(tmp_path / "log", "id,protocol\na,1\nb,2\n", a_npz=trace(1.0), b_npz=trace(2.0))
    )
    assert [dict(r.params) for r in backend.recordings] == [{"protocol": 1.0}, {"protocol": 2.0}]
    assert not any(r.protocol for r in backend.recordings)


@pytest.mark.parametrize(
    ("table", "facts"),
    [
        (TABLE.replace("b,,0.3", "b,,"), ["line 3", "'vd'", "empty"]),
        (TABLE.replace("c,squat,,0.5", "c,hold,,0.5"), ["c.csv", "'squat'", "line 4", "'hold'"]),
        (TABLE.replace("d,squat", "d,two words"), ["line 5", "'two words'"]),
        (TABLE.replace("c,squat,,0.5", "c,squat,,half"), ["line 4", "'amplitude'", "'half'"]),
    ],
)
def test_a_wrong_row_gets_one_sentence_with_file_and_line(folder, table, facts):
    (Path(folder) / "rollouts.csv").write_text(table)
    with pytest.raises(UsageError, match=naming(*facts)):
        LogBackend(folder)


def test_check_leaves_protocols_out_and_says_how_many(folder, tmp_path):
    result = s2r.check(s2r.parse_spec(SPEC), f"log:{folder}", tmp_path / "run")
    assert sum("2 rollouts of protocols" in sentence for sentence in result.assumptions) == 1
    assert result.certificate.rollouts == 2


def test_gap_leaves_protocols_out_on_both_sides(folder, tmp_path):
    other = write(
        tmp_path / "sim",
        "id,protocol,vd\na,,0.1\nb,,0.3\nc,hold,\n",
        a_npz=trace(1.5),
        b_npz=trace(1.7),
        c_npz=trace(2.0, "q"),
    )
    pairing = Pairing.for_spec(s2r.parse_spec(SPEC), "steady", f"log:{other}", f"log:{folder}", None)
    assert [len(group) for _, group in pairing.recorded.tests] == [1, 1]
    said = [sentence for sentence in pairing.notes if "protocol" in sentence]
    assert len(said) == 2
    assert "2 rollouts" in said[0]
    assert "1 rollout" in said[1]


def test_recordings_of_protocols_alone_certify_nothing(folder, tmp_path):
    for name in ("a.npz", "b.csv"):
        (Path(folder) / name).unlink()
    (Path(folder) / "rollouts.csv").write_text("".join(TABLE.splitlines(True)[i] for i in (0, 3, 4)))
    assert {r.protocol for r in LogBackend(folder).recordings} == {"squat"}
    with pytest.raises(UsageError, match=naming("2 recordings", "protocols")):
        s2r.check(s2r.parse_spec(SPEC), f"log:{folder}", tmp_path / "run")
