"""Logs as real robots leave them: clocks that begin anew, unset stamps, several senders of one topic, silences."""

from pathlib import Path

import numpy as np
import pytest

from s2r_spec import load_backend, logs, parse_spec, read_trace
from s2r_spec.errors import TraceError, UndecidedError, UsageError
from s2r_spec.logs.summary import summary
from s2r_spec.logs.topics.join import Joining
from s2r_spec.recordings.log_episodes import EpisodeSettings, ParamColumn, read_log_episodes, read_sources
from s2r_spec.recordings.log_folder import LogError
from tests.errors import naming, states
from tests.logs import robot_logs

SPEED = {"vx": "/odom.twist.linear.x"}
RECEIVED = Joining(stamps="received")


def bag(folder: Path, rows, silent=(), packed: bool = False) -> Path:
    """Write a ROS 2 bag.

    Args:
        folder: the bag.
        rows: (received [s], topic, type, message as a function of the types).
        silent: topic → type, of topics without messages.
        packed: whether each message is compressed.
    """
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    connections = {}
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3 if packed else StoragePlugin.MCAP)
    if packed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        for topic in silent:
            writer.add_connection(topic, silent[topic], typestore=store)
        for received, topic, kind, make in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            at = robot_logs.EPOCH + round(received * 1e9)
            writer.write(connections[topic], at, store.serialize_cdr(make(store.types), kind))
    return folder


def header(types, stamp):
    time = types["builtin_interfaces/msg/Time"](sec=int(stamp // 1), nanosec=round(stamp % 1 * 1e9))
    return types["std_msgs/msg/Header"](stamp=time, frame_id="")


def speed(received, stamp, value, topic="/odom"):
    """Return a row with a velocity, stamped by its sender [s]."""

    def make(types):
        vector, still = types["geometry_msgs/msg/Vector3"], (0.0, 0.0, 0.0)
        twist = types["geometry_msgs/msg/Twist"](vector(float(value), 0.0, 0.0), vector(*still))
        return types["geometry_msgs/msg/TwistStamped"](header=header(types, stamp), twist=twist)

    return received, topic, "geometry_msgs/msg/TwistStamped", make


def joints(received, positions):
    """Return a row with joint states: name → position."""

    def make(types):
        empty = np.zeros(0)
        return types["sensor_msgs/msg/JointState"](
            header(types, received),
            list(positions),
            np.array([*positions.values()], dtype=float),
            empty,
            empty,
        )

    return received, "/joint_states", "sensor_msgs/msg/JointState", make


def text(received, content):
    return received, "/mode", "std_msgs/msg/String", lambda types: types["std_msgs/msg/String"](data=content)


def test_headers_of_a_simulation_that_began_anew_are_not_mixed(tmp_path):
    rows = [speed(k * 0.1, 5.0 + k % 50 * 0.1, k >= 50) for k in range(100)]
    path = bag(tmp_path / "bag", rows)
    with pytest.raises(TraceError, match=naming("/odom", "4.9 s", "message 51", "--stamps received")):
        logs.load(path, SPEED, {"vx": None})
    trace = logs.load(path, SPEED, {"vx": None}, joining=RECEIVED).trace
    assert trace["vx"].tolist() == [0.0] * 50 + [1.0] * 50


def test_times_of_a_file_that_begin_anew_are_not_mixed(tmp_path):
    import h5py

    with h5py.File(tmp_path / "two.h5", "w") as stream:
        stream["t"], stream["vx"] = np.tile(np.arange(50) * 0.1, 2), np.repeat([0.0, 1.0], 50)
    with pytest.raises(TraceError, match=naming("4.9 s", "message 51")):
        logs.load(tmp_path / "two.h5", None, {"vx": None})


def test_messages_out_of_order_by_a_little_are_sorted(tmp_path):
    rows = [speed(k * 0.1, 5.0 + (k ^ 1) * 0.1, k ^ 1) for k in range(20)]
    trace = logs.load(bag(tmp_path / "bag", rows), SPEED, {"vx": None}).trace
    assert trace["vx"].tolist() == list(range(20))


def test_a_stamp_that_was_not_set_is_no_date(tmp_path):
    for unset in ({0, 7}, set(range(20))):
        rows = [speed(k * 0.1, 0.0 if k in unset else 5.0 + k * 0.1, k) for k in range(20)]
        path = bag(tmp_path / str(len(unset)), rows)
        with pytest.raises(TraceError, match=naming(f"{len(unset)} of 20", "/odom", "--stamps received")):
            logs.load(path, SPEED, {"vx": None})
        assert len(logs.load(path, SPEED, {"vx": None}, joining=RECEIVED).trace) == 20


def test_a_clock_may_begin_at_zero(tmp_path):
    path = bag(tmp_path / "bag", [speed(k * 0.1, k * 0.1, k) for k in range(20)])
    assert logs.load(path, SPEED, {"vx": None}).trace["vx"].tolist() == list(range(20))


def test_several_senders_of_joint_states_are_told_apart(tmp_path):
    rows = []
    for k in range(20):
        rows += [joints(k * 0.1, {"hip": k, "knee": -k}), joints(k * 0.1 + 0.01, {"finger": 9.0})]
    path = bag(tmp_path / "bag", rows)
    one = logs.load(path, {"q": "/joint_states.position.finger"}, {"q": None})
    assert one.trace["q"].tolist() == [9.0] * 20
    columns = {"q[0]": "/joint_states.position.knee", "q[1]": "/joint_states.position.hip"}
    both = logs.load(path, columns, {"q": 2})
    assert both.trace["q"].tolist() == [[-k, k] for k in range(20)]
    assert any(states(note, "20 messages", "/joint_states") for note in both.notes)


def test_a_vector_whose_joints_change_places_is_refused(tmp_path):
    rows = [
        joints(k * 0.1, {"hip": 1.0, "knee": 2.0} if k % 2 else {"knee": 2.0, "hip": 1.0}) for k in range(9)
    ]
    path = bag(tmp_path / "bag", rows)
    for column in ("/joint_states.position", "/joint_states.position[0]"):
        with pytest.raises(TraceError, match=naming("/joint_states.position.knee")):
            logs.load(path, {"q": column}, {"q": None if column.endswith("]") else 2})


def test_a_field_without_numbers_is_named_with_what_it_holds(tmp_path):
    path = bag(tmp_path / "bag", [text(0.0, "walk"), speed(0.1, 0.1, 0)])
    for column, held in (("/mode.data", "text"), ("/odom.header.stamp", "time")):
        with pytest.raises(TraceError, match=naming(column, held)):
            logs.load(path, {"vx": column}, {"vx": None})
    with pytest.raises(TraceError, match=naming("/odom.header.stamp", "--stamps")):
        logs.load(path, {"t": "/odom.header.stamp", **SPEED}, {"vx": None})


SPEC = parse_spec(robot_logs.SPEC)
COMMAND = {"vx_cmd": "/cmd.twist.linear.x"}
TEST = {"vd": ParamColumn(COMMAND["vx_cmd"], 0.0)}


def drive(folder: Path, without=(), clock: bool = False) -> Path:
    """Write a drive that follows a step of the command at 1 s, without the messages of /odom between two times [s]."""
    rows = []
    for k in range(140):
        at = k * 0.02
        if not (without and without[0] < at < without[1]):
            rows.append(speed(at, at + 50.0, 0.3 * (at >= 1.0)))
        if k % 5 == 0:
            rows.append(speed(at + 0.001, at + 50.001, 0.3 * (at >= 1.0), "/cmd"))
        if clock:
            rows += [speed(at + shift, at + shift + 50.0, 0.0, "/imu") for shift in (0.002, 0.012)]
    return bag(folder, rows)


def cut_out(path: Path, joining: Joining | None = None, **options):
    given = {"when": "vx_cmd > 0.05", "sources": TEST} | options
    settings = EpisodeSettings({**SPEED, **COMMAND}, None, joining, **given)
    return read_log_episodes(path, SPEC.signals, {"vx": None}, SPEC.horizon(), settings)


@pytest.mark.parametrize("clock", [None, "/imu"])
def test_a_sensor_that_is_silent_in_an_episode_is_named(clock, tmp_path):
    joining = Joining(clock=clock)
    loud = cut_out(drive(tmp_path / "loud", clock=bool(clock)), joining)
    outside = cut_out(drive(tmp_path / "outside", (0.2, 0.8), bool(clock)), joining)
    silent = cut_out(drive(tmp_path / "silent", (1.4, 2.1), bool(clock)), joining)
    assert not [note for found in (loud, outside) for note in found.silences if "#1" in note]
    (note,) = (note for note in silent.silences if "#1" in note)
    assert states(note, SPEED["vx"], "0.02 s")


def test_commands_are_held_where_signals_are_interpolated(tmp_path):
    path = drive(tmp_path / "bag", clock=True)
    for clock in ("/odom", "/imu"):
        (episode,) = cut_out(path, Joining(clock, "linear")).episodes
        assert episode.values["vd"] == (0.3, "")
        assert episode.begins == pytest.approx(1.0, abs=0.021)
    with pytest.raises(UsageError, match="vd"):
        read_sources(["vd=a@0", "vd=b@0"])


def test_a_test_parameter_after_the_episode_is_refused(tmp_path):
    path = drive(tmp_path / "bag")
    (episode,) = cut_out(path, sources={"vd": ParamColumn(COMMAND["vx_cmd"], 1.5)}).episodes
    assert episode.values["vd"] == (0.3, "")
    with pytest.raises(TraceError, match=naming("vd", "9 s", "1.5 s")):
        cut_out(path, sources={"vd": ParamColumn(COMMAND["vx_cmd"], 9.0)})


def test_an_episode_that_the_log_does_not_have_is_named(tmp_path):
    path = drive(tmp_path / "bag", (1.4, 2.1))
    with pytest.raises(TraceError, match=naming(path.name, "2.78 s", "9 s")):
        cut_out(path, when=None, start=9.0, duration=0.5)
    (episode,) = cut_out(path, when=None, start=1.41, duration=0.5).episodes
    with pytest.raises(UndecidedError):
        parse_spec("signal vx {m/s}\nrequire r: always[0, 0.5 s] (vx <= 9 {m/s})").robustness(episode.trace)


def test_a_unit_that_the_log_lacks_is_stated_or_named(tmp_path):
    path = bag(tmp_path / "bag", [speed(k * 0.1, 5.0 + k * 0.1, 0.5) for k in range(20)])
    field = "/odom.twist.linear.x"
    for unit, expected in (("deg/s", 1), ("rad/s", 0), ("N", 0), ("1", 0)):
        spec = parse_spec(f"signal w {{{unit}}}\nrequire r: always (abs(w) <= 10 {{{unit}}})")
        found = read_log_episodes(
            path, spec.signals, {"w": None}, spec.horizon(), EpisodeSettings({"w": field})
        )
        assert sum(states(note, field, unit) for note in found.notes) == expected
    spec = parse_spec("signal w {deg/s}\nrequire r: always (abs(w) <= 10 {deg/s})")
    stated = read_log_episodes(
        path, spec.signals, {"w": None}, spec.horizon(), EpisodeSettings({"w": f"{field} [rad/s]"})
    )
    assert not any(states(note, "deg/s") for note in stated.notes)
    assert spec.robustness(stated.episodes[0].trace)["r"] == pytest.approx(10 - np.rad2deg(0.5))


def test_a_stated_unit_counts_in_conditions_and_for_parameters(tmp_path):
    columns = {**SPEED, "vx_cmd": f"{COMMAND['vx_cmd']} [m/s]"}
    source = {"vd": ParamColumn(f"{COMMAND['vx_cmd']}[cm/s]", 0.0)}
    settings = EpisodeSettings(
        columns, when="vx_cmd > 5 {cm/s}", sources=source, joining=Joining(rule="linear")
    )
    path = drive(tmp_path / "bag")
    (episode,) = read_log_episodes(path, SPEC.signals, {"vx": None}, SPEC.horizon(), settings).episodes
    assert episode.texts() == ["vd=0.3 cm/s"]


def test_a_stated_unit_counts_and_a_note_names_the_unit_of_the_file(tmp_path):
    (tmp_path / "a.csv").write_text("t,v [m/s],w,q_0,q_1\n0,1,2,3,4\n1,1,2,3,4\n")
    read = logs.load(tmp_path / "a.csv", {"a": "w (rad)", "b": "q_1 [m]"}, {"a": None, "b": None}).trace
    assert read.units == {"a": "rad", "b": "m"}
    read = logs.load(tmp_path / "a.csv", {"a": "v [rad]"}, {"a": None})
    assert read.trace.units == {"a": "rad"}
    assert any(states(note, "a", "m/s", "rad") for note in read.notes)


@pytest.mark.filterwarnings("ignore::s2r_spec.errors.TraceNote")
def test_a_parameter_may_be_a_component_of_a_vector(tmp_path):
    path = bag(tmp_path / "night" / "bag", [joints(k * 0.1, {"hip": 1.0, "knee": k}) for k in range(20)])
    text = f"log:{path.parent}?map=q=/joint_states.position.hip&param=vd=/joint_states.position[1]@0.5&duration=1"
    (recording,) = load_backend(text).recordings
    assert dict(recording.params) == {"vd": 5.0}


@pytest.mark.parametrize("name", ["deeper", "packed", "broken"])
@pytest.mark.filterwarnings("ignore::s2r_spec.errors.TraceNote")
def test_a_log_of_the_folder_that_is_not_read_is_no_silent_choice(name, tmp_path):
    drive(tmp_path / "one")
    options = "map=vx=/odom.twist.linear.x&param=vd=/cmd.twist.linear.x@0&start=1&duration=1.5"
    (tmp_path / "map.png").write_bytes(b"")
    (tmp_path / "notes").mkdir()
    assert len(load_backend(f"log:{tmp_path}?{options}").recordings) == 1
    place = {"deeper": tmp_path / "monday" / "run", "packed": tmp_path / "run", "broken": tmp_path / "run"}[
        name
    ]
    path = drive(place)
    if name == "packed":
        (path / "run.mcap").rename(tmp_path / "run.mcap.zst")
    if name != "deeper":
        (path / "metadata.yaml").unlink()
    with pytest.raises(LogError, match="monday" if name == "deeper" else "run"):
        load_backend(f"log:{tmp_path}?{options}")
    if name == "broken":
        with pytest.raises(TraceError, match=naming("metadata.yaml", "run.mcap")):
            logs.load(path)


def test_a_stated_unit_of_times_counts_before_topics_are_joined(tmp_path):
    import h5py

    field = {"vx": "odom.vx", "vx_cmd": "cmd.vx"}
    for first in (0, robot_logs.EPOCH):
        path = tmp_path / f"{first}.h5"
        with h5py.File(path, "w") as stream:
            stream["odom/t"], stream["odom/vx"] = first + robot_logs.VX_NS, robot_logs.VX
            stream["cmd/t"], stream["cmd/vx"] = first + robot_logs.CMD_NS, robot_logs.CMD
        found = logs.load(path, field, {"vx": None, "vx_cmd": None}, time_unit="ns")
        assert found.trace.messages["vx"].times == pytest.approx(robot_logs.VX_NS * 1e-9)
        assert found.trace.messages["vx_cmd"].times == pytest.approx(robot_logs.CMD_NS * 1e-9)
        assert [topic.period for topic in summary(path, None, "ns").topics] == pytest.approx([0.05, 0.02])


def test_arrays_whose_samples_lie_along_another_axis_are_named_with_their_shape(tmp_path):
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as stream:
        stream["t"], stream["q"] = np.arange(50) * 0.1, np.zeros((3, 50))
    with pytest.raises(TraceError, match=naming("q", "3×50")):
        logs.load(tmp_path / "a.h5", None, {"q": 3})


def test_an_empty_cell_in_a_condition_is_named_with_its_file(tmp_path):
    path = robot_logs.plotjuggler(tmp_path / "drive.csv")
    columns = {"t": "__time", "vx": "/odom/vx", "vx_cmd": "/cmd/vx"}
    with pytest.raises(TraceError, match=naming("drive.csv", "vx_cmd")):
        read_log_episodes(
            path, SPEC.signals, {"vx": None}, SPEC.horizon(), EpisodeSettings(columns, when="vx_cmd > 0.05")
        )


@pytest.mark.filterwarnings("ignore::s2r_spec.errors.TraceNote")
def test_a_topic_without_messages_does_not_hide_the_others(tmp_path):
    rows = [speed(k * 0.1, 5.0 + k * 0.1, k) for k in range(20)]
    path = bag(tmp_path / "bag", rows, {"/never": "std_msgs/msg/Float64"})
    assert "/odom.twist.linear.x" in read_trace(path).channels
    with pytest.raises(TraceError, match=naming("/never.data")):
        logs.load(path, {"vx": "/never.data"}, {"vx": None})


def test_a_file_of_a_compressed_bag_names_the_bag(tmp_path):
    path = bag(tmp_path / "bag", [speed(k * 0.1, 5.0, k) for k in range(20)], packed=True)
    assert len(logs.load(path, SPEED, {"vx": None}, joining=RECEIVED).trace) == 20
    with pytest.raises(TraceError, match=naming(f"folder {path}")):
        logs.load(path / "bag.db3", SPEED, {"vx": None}, joining=RECEIVED)


def test_truth_values_are_held_where_numbers_are_interpolated(tmp_path):
    rows = [speed(k * 0.1, 5.0 + k * 0.1, k) for k in range(20)]
    rows += [
        (k * 0.4, "/on", "std_msgs/msg/Bool", lambda types, on=k > 1: types["std_msgs/msg/Bool"](data=on))
        for k in range(4)
    ]
    path = bag(tmp_path / "bag", sorted(rows, key=lambda row: row[0]))
    columns = {**SPEED, "on": "/on.data"}
    trace = logs.load(path, columns, {"vx": None, "on": None}, joining=Joining(rule="linear")).trace
    assert trace["on"].tolist() == [float(k >= 8) for k in range(20)]
