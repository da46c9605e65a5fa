"""A trace of messages keeps which samples are a channel's own, wherever it goes."""

import pickle

import numpy as np
import pytest

from s2r_spec import Trace, logs
from s2r_spec.trace.messages import Messages

REPEATED = np.array([0.0, 0.1, 0.1, 0.4])


def recording() -> Trace:
    """Return a measurement every 0.02 s, a flag that is sent on change, a vector, and a value that is sent twice."""
    fast = np.arange(50) * 0.02
    return Trace.of_messages(
        {
            "v": Messages.of(fast, np.sin(fast)),
            "hit": Messages.of(np.array([0.003, 0.403, 0.412]), np.array([0.0, 1.0, 0.0])),
            "q": Messages.of(fast[::7] + 0.001, np.stack([fast[::7], -fast[::7]], axis=1), linear=True),
            "twice": Messages.of(REPEATED, np.array([1.0, np.nan, 3.0, 4.0]), longest=2.0),
        },
        {"v": "m/s"},
        {"by": "hand"},
    )


def alike(one: Trace, other: Trace) -> None:
    assert (one.since, one.until) == (other.since, other.until)
    assert dict(one.units) == dict(other.units)
    assert dict(one.meta) == dict(other.meta)
    assert list(one.messages) == list(other.messages)
    for name, messages in one.messages.items():
        found = other.messages[name]
        np.testing.assert_array_equal(messages.times, found.times)
        np.testing.assert_array_equal(messages.values, found.values)
        for key in ("period", "longest", "log_end", "end", "linear"):
            assert getattr(messages, key) == pytest.approx(getattr(found, key), nan_ok=True)


@pytest.mark.parametrize("cut", [False, True], ids=["whole", "episode"])
@pytest.mark.parametrize("kind", ["npz", "csv", "parquet", "pandas", "pyarrow", "pickle"])
def test_messages_come_back(kind, cut, tmp_path):
    trace = recording()
    if cut:
        trace = trace.between(0.391, 0.777).shift(-0.391)
        assert trace.times[0] == 0.0
        assert not trace.own("v")[0]
    if kind == "pickle":
        back = pickle.loads(pickle.dumps(trace))
    elif kind in ("pandas", "pyarrow"):
        back = Trace.from_dataframe(trace.to_dataframe(kind))
    else:
        logs.write(trace, tmp_path / f"trace.{kind}")
        back = logs.read(tmp_path / f"trace.{kind}")
    alike(trace, back)


@pytest.mark.parametrize("kind", ["npz", "csv", "parquet"])
def test_a_resampled_trace_knows_its_own_samples(kind, tmp_path):
    trace = recording().only(["v", "hit"]).resample(0.05)
    assert trace.own("v").tolist() == [k % 2 == 0 for k in range(len(trace))]
    logs.write(trace, tmp_path / f"trace.{kind}")
    back = logs.read(tmp_path / f"trace.{kind}")
    assert not back.messages
    for name in ("v", "hit"):
        np.testing.assert_array_equal(back[name], trace[name])
        np.testing.assert_array_equal(back.own(name), trace.own(name))
    assert back.only(["v"]).between(0.1, 0.5).own("v").tolist() == trace.own("v")[2:11].tolist()


def test_a_channel_alone_has_none_of_the_stamps_of_the_others():
    trace = recording()
    assert trace.only(["hit"]).times.tolist() == [0.003, 0.403, 0.412]
    assert trace.only(["v"]).common().times.tolist() == trace.messages["v"].times.tolist()
    assert trace.only(["v", "hit"]).own("hit").sum() == 3


def test_an_old_file_has_own_samples_only(tmp_path):
    path = tmp_path / "old.csv"
    path.write_text("t,v\n0,1\n1,2\n")
    assert logs.read(path).own("v").all()


def test_a_record_of_a_newer_version_is_refused(tmp_path):
    path = tmp_path / "new.csv"
    path.write_text('# s2r {"meta": {}, "own": {"version": 99, "messages": {}}}\nt,v\n0,1\n1,2\n')
    with pytest.raises(logs.TraceError, match=path.name):
        logs.read(path)
