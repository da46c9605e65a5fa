"""Logs of topics: every format of one drive gives the same ρ, and what is damaged or ambiguous is refused."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from s2r_spec import logs, parse_spec, read_episodes
from s2r_spec.errors import TraceError
from s2r_spec.logs.interpret import at_clock
from s2r_spec.logs.topics.join import Joining
from s2r_spec.recordings.episodes import find_episodes
from s2r_spec.recordings.log_episodes import EpisodeSettings, ParamColumn, read_log_episodes
from s2r_spec.trace import Trace
from s2r_spec.trace.messages import Messages
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
    settings = EpisodeSettings(
        columns, None, joining, "vx_cmd > 0.05", sources={"vd": ParamColumn(columns["vx_cmd"], 0.0)}
    )
    return read_log_episodes(path, SPEC.signals, {"vx": None}, SPEC.horizon(), settings)


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
    if name in ("ulog", "mcap", "ros1") and left == 0.5:  # the power failed: the messages before are whole
        assert len(logs.load(path, columns, {"vx": None}).trace) < len(robot_logs.VX)
        return
    with pytest.raises(TraceError, match=path.name):
        logs.load(path, columns, {"vx": None})


def test_stamps_of_two_clocks_are_refused_not_joined(tmp_path):
    """Headers in simulated time beside headers with dates: each looks right by itself."""
    bag = robot_logs.two_clocks(tmp_path / "bag")
    columns = {"vx": "/odom.twist.linear.x", "wz": "/imu.twist.angular.z"}
    with pytest.raises(TraceError, match=r"different clocks.*/imu.*/odom|different clocks.*/odom.*/imu"):
        logs.load(bag, columns, {"vx": None, "wz": None})
    received = logs.load(bag, columns, {"vx": None, "wz": None}, joining=Joining(stamps="received"))
    assert len(received.trace) == 100


def test_dates_beside_durations_are_refused(tmp_path):
    path = tmp_path / "drive.h5"
    import h5py

    with h5py.File(path, "w") as stream:
        stream["odom/t"], stream["odom/vx"] = robot_logs.EPOCH + robot_logs.VX_NS, robot_logs.VX
        stream["odom/t"].attrs["units"] = "ns"
        stream["cmd/t"], stream["cmd/vx"] = robot_logs.CMD_NS * 1e-9, robot_logs.CMD
    with pytest.raises(TraceError, match=path.name):
        logs.load(path, FIELDS, {"vx": None, "vx_cmd": None})


@pytest.mark.parametrize(("unit", "per_second"), [("ns", 10**9), ("us", 1e6), ("ms", 1e3)])
def test_dates_of_two_topics_agree_whatever_their_units(unit, per_second, tmp_path):
    import h5py

    with h5py.File(tmp_path / "drive.h5", "w") as stream:
        stream["odom/t"], stream["odom/vx"] = robot_logs.EPOCH + robot_logs.VX_NS, robot_logs.VX
        stream["odom/t"].attrs["units"] = "ns"
        stream["cmd/t"] = (robot_logs.EPOCH + robot_logs.CMD_NS) * (per_second / 10**9)
        stream["cmd/t"].attrs["units"], stream["cmd/vx"] = unit, robot_logs.CMD
    (episode,) = episodes(tmp_path / "drive.h5", FIELDS).episodes
    # A float64 of nanoseconds since 1970 resolves 256 ns, so that a command may come a sample late.
    assert episode.begins == pytest.approx(robot_logs.STEP, abs=0.02 + 1e-6)
    assert SPEC.robustness(episode.trace, {"vd": 0.3})["reaches"] == pytest.approx(RHO, abs=1e-3)


def test_a_joint_is_found_by_its_name_wherever_it_stands(tmp_path):
    bag = robot_logs.joints(tmp_path / "bag", [(1, 2, 3), (3, 1, 2), (2, 3)] * 5)
    columns = {"q2": "/joint_states.position.leg/2", "q1": "/joint_states.position.leg/1"}
    trace = logs.load(bag, columns, {"q1": None, "q2": None}).trace
    assert set(trace["q2"].tolist()) == {2.0}
    assert set(trace["q1"].tolist()) == {1.0}  # held where a message lacks the joint


def test_the_episodes_of_a_lerobot_table_are_traces_of_their_own(tmp_path):
    path = robot_logs.lerobot(tmp_path / "data.parquet")
    columns = {"t": "timestamp", "vx": "observation.state[1]"}
    found = read_log_episodes(path, SPEC.signals, {"vx": None}, SPEC.horizon(), EpisodeSettings(columns))
    assert [episode.trace["vx"][0] for episode in found.episodes] == pytest.approx([0.0, 0.1, 0.2])
    assert all(len(episode.trace) == 100 for episode in found.episodes)
    sources = {"vd": ParamColumn("observation.state[0]", 0.0)}
    found = read_log_episodes(
        path, SPEC.signals, {"vx": None}, SPEC.horizon(), EpisodeSettings(columns, sources=sources)
    )
    assert [episode.values["vd"][0] for episode in found.episodes] == pytest.approx([0.3] * 3)
    with pytest.raises(TraceError, match="3 episodes"):
        logs.load(path, columns, {"vx": None})


@pytest.mark.parametrize("name", FORMATS)
def test_a_wrong_topic_is_named_with_those_that_the_log_has(name, tmp_path):
    write, columns = FORMATS[name]
    path = write(tmp_path)
    wrong = columns["vx"].replace("odom", "odometry")
    with pytest.raises(TraceError, match=re.escape(columns["vx"])) as caught:
        logs.load(path, {"vx": wrong}, {"vx": None})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", FORMATS)
def test_more_than_the_memory_holds_is_refused_before_it_is_read(name, tmp_path, monkeypatch):
    write, columns = FORMATS[name]
    path = write(tmp_path)
    monkeypatch.setattr("s2r_spec.logs.table.MOST_NUMBERS", 500)
    with pytest.raises(TraceError, match="million"):
        logs.load(path, columns, {"vx": None})


@pytest.mark.filterwarnings("ignore::s2r_spec.errors.TraceNote")
def test_python_reads_the_episodes_with_their_tests(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "MCAP")
    found = read_episodes(bag, SPEC, ROS, when="vx_cmd > 0.05", params={"vd": f"{ROS['vx_cmd']}@0"})
    ((test, trace),) = found
    assert test == {"vd": 0.3}
    assert SPEC.robustness(trace, test)["reaches"] == pytest.approx(RHO, abs=1e-9)
    ((test, trace),) = read_episodes(bag, SPEC, ROS, params={"vd": "20 cm/s"})
    assert test == {"vd": 0.2}
    assert len(trace) == 400


def test_an_episode_may_begin_with_the_first_message_of_its_command(tmp_path):
    """A teleoperated robot has no command before the first one."""
    bag = robot_logs.ros2(tmp_path / "bag", "MCAP", idle=False)
    (episode,) = episodes(bag, ROS).episodes
    assert episode.begins == pytest.approx(robot_logs.STEP, abs=1e-6)
    assert SPEC.robustness(episode.trace, {"vd": 0.3})["reaches"] == pytest.approx(RHO, abs=1e-9)


def channel(stamps, linear=False):
    return Messages.of(np.array(stamps, dtype=float), np.array(stamps, dtype=float), linear=linear)


def test_topics_without_a_time_in_common_are_refused():
    with pytest.raises(TraceError):
        at_clock(Trace.of_messages({"a": channel([0, 1]), "b": channel([5, 6])}), np.array([0.0, 1.0]))


sorted_times = st.lists(st.integers(0, 200), min_size=2, max_size=30, unique=True).map(sorted)


@given(sorted_times, sorted_times)
def test_a_held_value_is_the_last_one_that_came(own, clock):
    expected = [max((at for at in own if at <= now), default=None) for now in clock]
    kept = [value for value in expected if value is not None]
    trace = Trace.of_messages({"clock": channel(clock), "other": channel(own)})
    if own == clock:
        assert trace.common()["other"].tolist() == own
    elif not kept:
        with pytest.raises(TraceError):
            at_clock(trace, np.array(clock, dtype=float))
    else:
        assert at_clock(trace, np.array(clock, dtype=float)).known()["other"].tolist() == kept


@given(sorted_times, sorted_times)
def test_an_interpolated_straight_line_stays_one(own, clock):
    trace = Trace.of_messages({"clock": channel(clock), "other": channel(own, linear=True)})
    if any(own[0] <= now <= own[-1] for now in clock):
        found = at_clock(trace, np.array(clock, dtype=float)).known()
        assert found["other"] == pytest.approx(found.times)
        assert found.own("other").tolist() == [now in own for now in found.times]


@given(st.lists(st.booleans(), min_size=2, max_size=60), st.integers(1, 10))
def test_no_sample_is_in_two_episodes_and_each_begins_where_the_condition_does(truth, length):
    truth, times = np.array(truth), 0.1 * np.arange(len(truth))
    found = find_episodes(times, truth, 0.1 * length)
    for begin, end in found.ranges:
        assert truth[begin]
        assert not truth[begin - 1]
        assert end - begin == length + 1
    assert all(one[1] <= next_[0] for one, next_ in zip(found.ranges, found.ranges[1:], strict=False))
    begins = int((truth[1:] & ~truth[:-1]).sum())
    assert len(found.ranges) + found.within + found.incomplete == begins


@pytest.mark.parametrize("way", [{"when": "vx_cmd > 0.05"}, {"start": 2.0}])
def test_the_episode_that_a_failure_ends_is_kept_and_only_it_has_failed(tmp_path, way):
    """Left out, the robot's fall would leave only its successes."""
    times = np.arange(51) * 0.1
    command = ((times >= 0.5) & (times < 2.5)) | (times >= 4.0)
    channels = {"vx": 0.3 * command, "vx_cmd": 0.3 * command}
    logs.write(Trace(times, channels, {"vx": "m/s"}, {"failure": "fall"}), tmp_path / "fell.npz")
    found = read_log_episodes(
        tmp_path / "fell.npz",
        SPEC.signals,
        {"vx": None},
        1.5 if "when" in way else 4.0,
        EpisodeSettings(**way),
    )
    assert [one.trace.failure for one in found.episodes] == ([None, "fall"] if "when" in way else ["fall"])
    logs.write(Trace(times, channels, {"vx": "m/s"}), tmp_path / "ended.npz")
    if "when" in way:
        (only,) = read_log_episodes(
            tmp_path / "ended.npz", SPEC.signals, {"vx": None}, 1.5, EpisodeSettings(**way)
        ).episodes
        assert only.trace.failure is None
