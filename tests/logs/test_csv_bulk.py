"""A large CSV file read by pyarrow gives what the reader of rows gives, or is left to it."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec import logs
from s2r_spec.errors import UsageError
from s2r_spec.logs.formats import csv_bulk

SMALL = csv_bulk.FROM
CELLS = st.sampled_from(
    ["1", "-0", "007", "1.5", "-2e-3", "1e999", "inf", "nan", "NA", "", " 3 ", "+4", "0x1F", "1_0", "true", "5\r", "x",
     "9007199254740993", "99999999999999999999", '"6"', ".5", "5.", "0,1", "2024-06-10T06:13:20Z", "é"]
)  # fmt: skip
ENDS = st.sampled_from(["\n", "\r\n", "\n\n", "\r", ",\n", ""])
ROWS = st.lists(st.tuples(st.floats(0, 9).map(repr), CELLS, CELLS, ENDS), min_size=1, max_size=6)


def read(path, smallest):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_bulk, "FROM", smallest)
        try:
            found = logs.load(path)
        except UsageError as error:
            return str(error)
    trace = found.trace
    samples = {name: values.tolist() for name, values in trace.channels.items()}
    return repr((trace.times.tolist(), samples, dict(trace.units), found.notes, found.left_out))


@settings(deadline=None, max_examples=300)
@given(
    ROWS, st.sampled_from(["t,v,w\n", "t [s],v [m/s],w\r\n", "# t,v,w\n", '"t",v,w\n', "t,v,w\ns,m/s,-\n"])
)
def test_both_readers_agree(tmp_path_factory, rows, header):
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    path.write_text(header + "".join(f"{t},{v},{w}{end}" for t, v, w, end in rows), newline="")
    assert read(path, 1) == read(path, SMALL)


def test_a_plain_table_is_read_in_bulk_and_to_the_last_bit(tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    monkeypatch.setattr(csv_bulk, "FROM", 10_000)
    path: Path = tmp_path / "a.csv"
    values = np.random.default_rng(0).normal(size=5_000)
    path.write_text("t,v\n" + "".join(f"{k},{x!r}\n" for k, x in enumerate(values.tolist())))
    assert path.stat().st_size > csv_bulk.FROM
    found = csv_bulk.numbers(path, 1, 2, [0, 1])
    assert found is not None
    assert (found[1] == values).all()
    assert found[0].dtype == np.int64
    assert (logs.load(path).trace["v"] == values).all()
    with path.open("a") as stream:
        stream.write("5001,one\n")
    assert "v" in logs.load(path).left_out
    with pytest.raises(UsageError, match="line 5002, column 2"):
        logs.load(path, None, ["v"])
