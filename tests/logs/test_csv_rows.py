"""Rows, comments and ends of CSV files, read whole and line by line: both give the same samples and notes."""

import io
from pathlib import Path

import pytest

from s2r_spec import logs
from s2r_spec.errors import TraceError
from s2r_spec.logs.formats.follow import follow
from s2r_spec.logs.interpret import request
from tests.errors import naming


def both(path: Path, text: str, **asked) -> tuple[list[float], list, list[str]]:
    """Return times, samples of v and notes; the same of the file and of its lines."""
    path.write_text(text, newline="")
    columns, wanted, unit = (asked.get(name) for name in ("columns", "wanted", "time_unit"))
    found = logs.load(path, columns, wanted, time_unit=unit)
    rows = follow(io.StringIO(text, newline="").readline, request(columns, wanted, unit))
    samples = list(rows.samples)
    assert [time for time, _ in samples] == found.trace.times.tolist()
    assert str([sample["v"] for _, sample in samples]) == str(found.trace["v"].tolist())
    assert rows.notes == list(found.notes)
    assert rows.units == dict(found.trace.units)
    return found.trace.times.tolist(), found.trace["v"].tolist(), rows.notes


@pytest.mark.parametrize(
    "text",
    [
        "t,v,\n0,5,\n1,6,\n",
        "t,v\n0,5,\n1,6,,\n",
        "t,v,\n0,5\n1,6\n",
        "# a rosbag\n\n# robot 7\nt,v\n0,5\n1,6\n",
        '# mine\n# s2r {"meta": {"failure": ""}}\nt,v\n0,5\n1,6\n',
        "# t,v\n0,5\n1,6\n",  # as numpy.savetxt writes it
        "#t [s],note,v\n0,here,5\n1,there,6\n",
        ",t,v\n0,0,5\n1,1,6\n",
        "t[ms],v\n0,5\n1000,6\n",
        "t,v\r\n0,5\r\n\r\n1,6\r\n,\r\n",
        "t,v\r0,5\r1,6\r",
        '\ufeff"t","v"\n"0","5"\n 1 , 6 \n',
        "t [ms],v\n0,5\n1000,6\n",
        "t,v\n2024-06-10T06:13:20Z,5\n2024-06-10T06:13:21Z,6\n",
        "t,note,v\n0,wörk,5\n1,,6\n",
    ],
)
def test_whole_files(tmp_path, text):
    assert both(tmp_path / "a.csv", text, wanted=["v"]) == ([0, 1], [5, 6], [])


@pytest.mark.parametrize(
    "end",
    ["2,0.", "2,0.7", "2", "2\n", "2,", '2,"0.', "2,0.7,", "2,0.7,9"],
)
def test_a_last_row_that_is_cut_is_a_note_and_not_a_number(tmp_path, end):
    wide = "t,v,w\n0,5,1\n1,6,1\n" if end.count(",") > 1 or end == "2,0.7,9" else "t,v\n0,5\n1,6\n"
    wanted = ["v", "w"] if "w" in wide else ["v"]
    times, v, notes = both(tmp_path / "a.csv", wide + end, wanted=wanted)
    assert (times, v) == ([0, 1], [5, 6])
    (note,) = notes
    assert "line 4" in note


def test_a_last_row_is_whole_if_only_what_nobody_reads_is_cut(tmp_path):
    assert both(tmp_path / "a.csv", "t,v,mode\n0,5,walk\n1,6,wa", wanted=["v"]) == ([0, 1], [5, 6], [])


def test_a_row_that_is_short_in_the_middle_is_a_mistake(tmp_path):
    with pytest.raises(TraceError, match=naming("line 3", "1", "2")):
        both(tmp_path / "a.csv", "t,v\n0,5\n1\n2,6\n", wanted=["v"])
    rows = follow(io.StringIO("t,v\n0,5\n1\n2,6\n").readline, request(None, ["v"], None))
    assert next(rows.samples) == (0, {"v": 5})
    with pytest.raises(TraceError, match=naming("line 3", "1", "2")):
        next(rows.samples)


def test_rows_that_come_in_count_from_the_first_one(tmp_path):
    text = "a.sec,a.nanosec,v\n1718000000,900000000,5\n1718000001,000000001,6\n"
    assert both(tmp_path / "a.csv", text, columns={"t": "a"})[0] == [0, 0.100000001]
    assert both(tmp_path / "b.csv", "k,v\n1718000000000000000,5\n1718000000100000001,6\n", columns={"t": "k"},
                time_unit="ns")[0] == [0, 0.100000001]  # fmt: skip


def test_bytes_that_are_no_text_in_columns_that_nobody_reads(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes("t,v,angle [°]\n0,5,1\n1,6,2\n".encode("latin-1"))
    assert logs.read(path, wanted=["v"])["v"].tolist() == [5, 6]


def test_truth_values_and_vectors_row_by_row(tmp_path):
    text = "t,v,q_0,q_1\n0,True,1,2\n1,no,3,\n"
    wanted = {"v": None, "q": 2}
    assert both(tmp_path / "a.csv", text, wanted=wanted)[1] == [1, 0]
    rows = follow(io.StringIO(text).readline, request(None, wanted, None))
    assert str([sample["q"] for _, sample in rows.samples]) == "[[1.0, 2.0], [3.0, nan]]"
