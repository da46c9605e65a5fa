"""Logs of topics: every format of one drive gives the same ρ, and what is damaged or ambiguous is refused."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from s2r_spec import logs, parse_spec
from s2r_spec.errors import TraceError
from s2r_spec.logs.episodes import cut
from s2r_spec.logs.table import Column
from s2r_spec.logs.topics.join import Joining, join
from s2r_spec.logs.topics.topic import Topic
from s2r_spec.rollouts.excerpts import Excerpts, Source, excerpt
from tests.logs import robot_logs
from tests.logs.robot_logs import RHO

ROS = {"vx": "/odom.twist.linear.x", "vx_cmd": "/cmd_vel.linear.x"}
FIELDS = {"vx": "odom.vx", "vx_cmd": "cmd.vx"}
FORMATS = {
    "ros2.sqlite3": (lambda folder: robot_logs.ros2(folder / "bag", "SQLITE3"), ROS),
    "ros2.mcap": (lambda folder: robot_logs.ros2(folder / "bag", "MCAP"), ROS),
    "mcap": (lambda folder: robot_logs.ros2(folder / "bag", "MCAP") / "bag.mcap", ROS),
    "db3": (lambda folder: robot_logs.ros2(folder / "bag", "SQLITE3") / "bag.db3", ROS),
    "ros1": (lambda folder: robot_logs.ros1(folder / "drive.bag"), ROS),
    "matlab": (lambda folder: robot_logs.matlab(folder / "drive.mat"), FIELDS),
    "hdf5": (lambda folder: robot_logs.hdf5(folder / "drive.h5"), FIELDS),
    "ulog": (lambda folder: robot_logs.ulog(folder / "drive.ulg"), FIELDS),
}
SPEC = parse_spec(robot_logs.SPEC)


def episodes(path, columns, joining=None):
    excerpts = Excerpts(
        columns, None, joining, "vx_cmd > 0.05", sources={"vd": Source(columns["vx_cmd"], 0.0)}
    )
    return excerpt(path, SPEC.signals, {"vx": None}, SPEC.horizon(), excerpts)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_of_one_drive_gives_the_same_robustness(name, tmp_path):
    write, columns = FORMATS[name]
    (episode,) = episodes(write(tmp_path), columns).episodes
    assert SPEC.read_params(episode.texts()) == {"vd": 0.3}
    assert episode.begins == pytest.approx(robot_logs.STEP, abs=1e-6)
    assert SPEC.robustness(episode.trace, {"vd": 0.3})["reaches"] == pytest.approx(RHO, abs=1e-9)


def test_a_table_with_empty_cells_gives_it_too(tmp_path):
    path = robot_logs.plotjuggler(tmp_path / "drive.csv")
    columns = {"t": "__time", "vx": "/odom/vx", "vx_cmd": "/cmd/vx"}
    (episode,) = episodes(path, columns, Joining(clock="vx")).episodes
    assert SPEC.robustness(episode.trace, {"vd": 0.3})["reaches"] == pytest.approx(RHO, abs=1e-9)


def test_stamps_are_those_of_the_headers_only_if_all_topics_have_one(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "MCAP", header_shift=-5_000_000)
    one = logs.load(bag, ROS, {"vx": None})
    assert "headers" in one.notes[0]
    both = logs.load(bag, ROS, {"vx": None, "vx_cmd": None})
    assert "receipt" in both.notes[0]
    assert "/cmd_vel" in both.notes[0]
    with pytest.raises(TraceError, match="/cmd_vel"):
        logs.load(bag, ROS, {"vx": None, "vx_cmd": None}, joining=Joining(stamps="header"))


def test_what_the_log_lacks_is_named_with_what_it_has(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "MCAP")
    with pytest.raises(TraceError, match=re.escape("/odom.twist.linear.x")):
        logs.load(bag, {"vx": "/odom.linear.x"}, {"vx": None})


@pytest.mark.parametrize("name", ["mcap", "db3", "ros1", "matlab", "hdf5", "ulog"])
@pytest.mark.parametrize("left", [0, 6, 0.5])
def test_a_file_that_is_cut_off_or_empty_is_refused_or_told(name, left, tmp_path):
    write, columns = FORMATS[name]
    path = write(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: left if isinstance(left, int) else int(left * len(data))])
    if name == "ulog" and left == 0.5:  # a log of a flight that ended without power: its messages are whole
        assert len(logs.load(path, columns, {"vx": None}).trace) < len(robot_logs.VX)
        return
    with pytest.raises(TraceError, match=path.name):
        logs.load(path, columns, {"vx": None})


def topic(name, stamps, values):
    return Topic(name, np.array(stamps, dtype=float), {"y": Column(np.array(values, dtype=float))})


def test_topics_without_a_time_in_common_are_refused():
    with pytest.raises(TraceError, match="b from 5"):
        join({"a": topic("a", [0, 1], [0, 0]), "b": topic("b", [5, 6], [0, 0])}, Joining(clock="a"))


sorted_times = st.lists(st.integers(0, 200), min_size=2, max_size=30, unique=True).map(sorted)


@given(sorted_times, sorted_times)
def test_a_held_value_is_the_last_one_that_came(own, clock):
    topics = {"clock": topic("clock", clock, clock), "other": topic("other", own, own)}
    expected = [max((at for at in own if at <= now), default=None) for now in clock]
    kept = [value for value in expected if value is not None]
    if not kept:
        with pytest.raises(TraceError):
            join(topics, Joining(clock="clock"))
        return
    found = join(topics, Joining(clock="clock"))
    assert found.columns["other", "y"].values.tolist() == kept


@given(sorted_times, sorted_times)
def test_an_interpolated_straight_line_stays_one(own, clock):
    topics = {"clock": topic("clock", clock, clock), "other": topic("other", own, own)}
    if not any(own[0] <= now <= own[-1] for now in clock):
        return
    found = join(topics, Joining(clock="clock", rule="linear"))
    assert found.columns["other", "y"].values == pytest.approx(found.stamps)


@given(st.lists(st.booleans(), min_size=2, max_size=60), st.integers(1, 10))
def test_no_sample_is_in_two_episodes_and_each_begins_where_the_condition_does(truth, length):
    truth, times = np.array(truth), 0.1 * np.arange(len(truth))
    found = cut(times, truth, 0.1 * length)
    for begin, end in found.spans:
        assert truth[begin]
        assert not truth[begin - 1]
        assert end - begin == length + 1
    assert all(one[1] <= next_[0] for one, next_ in zip(found.spans, found.spans[1:], strict=False))
    begins = int((truth[1:] & ~truth[:-1]).sum())
    assert len(found.spans) + found.within + found.incomplete == begins
