"""Bags whose recorder was killed, files that lost a part, and definitions that changed: nothing is lost unseen."""

import os
import shutil
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import Stores, get_typestore

from s2r_spec import logs
from s2r_spec.errors import TraceError
from s2r_spec.logs.summary import summary
from s2r_spec.logs.topics.join import Joining
from s2r_spec.logs.topics.rosbag import RosBag
from tests.cli.conftest import s2r as s2r  # the command line in a folder of its own
from tests.errors import naming, states
from tests.logs import robot_logs
from tests.logs.robot_logs import EPOCH, TOPICS, VX

SPEED = {"vx": "/odom.twist.linear.x"}
HUMBLE = get_typestore(Stores.ROS2_HUMBLE)


def read(path):
    found = logs.load(path, SPEED, {"vx": None})
    return found.trace, found.notes


def chunked(folder: Path, monkeypatch, packed: bool = False) -> Path:
    """Write the drive into an MCAP file of chunks of 8 kB, about 60 messages each."""
    written = McapWriter.write

    def write(self, *arguments):
        written(self, *arguments)
        if self.chunk.bio.tell() > 2**13:
            self.close_chunk()

    monkeypatch.setattr(McapWriter, "write", write)
    if packed:
        opened = Writer.open

        def open_packed(self):
            self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            opened(self)

        monkeypatch.setattr(Writer, "open", open_packed)
    return robot_logs.ros2(folder, "MCAP") / f"{folder.name}.mcap"


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Return (begin, end) of each chunk of an MCAP file."""
    found, at = [], 8
    while at < len(data) - 8:
        kind, size = struct.unpack_from("<BQ", data, at)
        found += [(at, at + 9 + size)] if kind == 6 else []
        at += 9 + size
    return found


def killed(folder: Path, ending: str = "-wal") -> Path:
    """Write the drive into a SQLite file whose last 100 messages are in a journal only, and return the file."""
    path = robot_logs.ros2(folder / "whole", "SQLITE3") / "whole.db3"
    database = sqlite3.connect(path)
    rows = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp").fetchall()
    database.execute("DELETE FROM messages")
    database.commit()
    add = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)"
    if ending == "-wal":
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
    database.executemany(add, rows[:-100])
    database.commit()
    if ending == "-wal":
        database.execute("PRAGMA wal_checkpoint(FULL)")
        database.executemany(add, rows[-100:])
        database.commit()
    else:  # changes that were not committed are in the file, and how to undo them in the journal
        database.execute("PRAGMA cache_size=1")
        database.execute("UPDATE messages SET timestamp = 0, data = zeroblob(200)")
    (folder / "killed").mkdir()
    copy = folder / "killed" / "rec.db3"
    shutil.copyfile(path, copy)
    shutil.copyfile(f"{path}{ending}", f"{copy}{ending}")
    database.close()
    return copy


def test_messages_in_a_journal_of_sqlite_are_read(tmp_path):
    path = killed(tmp_path)
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    trace, notes = read(path)
    assert trace["vx"].tolist() == pytest.approx(VX)
    assert any(states(note, "rec.db3-wal") for note in notes)
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before


def test_what_was_never_committed_is_undone_as_sqlite_does(tmp_path):
    path = killed(tmp_path, "-journal")
    trace, notes = read(path)
    assert trace["vx"].tolist() == pytest.approx(VX[: len(trace)])
    assert 300 < len(trace) < 400
    assert any(states(note, "rec.db3-journal") for note in notes)


def test_a_journal_beside_a_file_of_a_folder_is_read(tmp_path):
    path = killed(tmp_path)
    folder = tmp_path / "whole"
    for file in path.parent.iterdir():
        shutil.copyfile(file, folder / file.name.replace("rec", "whole"))
    trace, notes = read(folder)
    assert trace["vx"].tolist() == pytest.approx(VX)
    assert any(states(note, "whole.db3-wal") for note in notes)


def test_an_empty_journal_is_no_fault(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "SQLITE3")
    for ending in ("-wal", "-shm", "-journal"):
        (bag / f"bag.db3{ending}").touch()
    trace, notes = read(bag)
    assert len(trace) == len(VX)
    assert not any("bag.db3" in note for note in notes)


def test_a_journal_that_cannot_be_copied_is_named_with_the_way_out(tmp_path, monkeypatch):
    path = killed(tmp_path)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(TraceError, match=naming("rec.db3-wal", "No space left on device", "wal_checkpoint")):
        read(path)


@pytest.mark.parametrize(("left", "listed"), [(300, 400), (400, 300)])
def test_fewer_or_more_messages_than_the_metadata_lists_are_told(left, listed, tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "SQLITE3")
    odom = "(SELECT id FROM topics WHERE name = '/odom')"
    with sqlite3.connect(bag / "bag.db3") as database:
        latest = f"SELECT id FROM messages WHERE topic_id = {odom} ORDER BY timestamp DESC LIMIT ?"
        database.execute(f"DELETE FROM messages WHERE id IN ({latest})", (400 - left,))
    database.close()
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 400", f"message_count: {listed}"))
    trace, notes = read(bag)
    assert len(trace) == left
    assert any(states(note, f"{left} messages", "/odom", "metadata.yaml", str(listed)) for note in notes)
    assert any("incomplete" in note for note in notes) == (left < listed)


def test_a_complete_bag_has_no_note_on_its_files(tmp_path):
    for name in ("SQLITE3", "MCAP"):
        _, notes = read(robot_logs.ros2(tmp_path / name, name))
        assert not any(
            word in note for note in notes for word in ("incomplete", "closed", "damaged", "left out")
        )


def test_a_missing_file_of_a_split_bag_is_named(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "SQLITE3")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- bag.db3", "- bag.db3\n  - bag_1.db3"))
    with pytest.raises(TraceError, match=naming("bag_1.db3", "metadata.yaml", "reindex")):
        read(bag)


def test_a_folder_of_several_files_without_metadata_tells_that_each_is_a_part(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "SQLITE3")
    (bag / "metadata.yaml").unlink()
    shutil.copyfile(bag / "bag.db3", bag / "bag_1.db3")
    with pytest.raises(TraceError, match=naming("bag.db3", "bag_1.db3", "part", "reindex")):
        read(bag)


@pytest.mark.parametrize("packed", [False, True])
def test_the_whole_chunks_of_a_file_without_its_end_are_read(packed, tmp_path, monkeypatch):
    path = chunked(tmp_path / "bag", monkeypatch, packed)
    data = path.read_bytes()
    parts = chunks(data)
    assert len(parts) > 3
    lengths = []
    for begin, end in parts[1:]:
        alone = tmp_path / "cut.mcap"
        alone.write_bytes(data[: (begin + end) // 2])
        trace, notes = read(alone)
        assert trace["vx"].tolist() == pytest.approx(VX[: len(trace)])
        (note,) = (note for note in notes if "cut.mcap" in note)
        assert states(note, "mcap recover", "messages")
        assert not packed or states(note, f"{(end - begin) // 2:,} bytes")
        lengths.append(len(trace))
    assert lengths == sorted({*lengths})


def test_zeros_that_a_loss_of_power_leaves_are_no_messages(tmp_path, monkeypatch):
    path = chunked(tmp_path / "bag", monkeypatch)
    data = path.read_bytes()
    begin, end = chunks(data)[2]
    cut = tmp_path / "cut.mcap"
    for place in range(begin + 2000, begin + 2400, 37):
        cut.write_bytes(data[:place] + bytes(end - place))
        trace, notes = read(cut)
        assert trace["vx"].tolist() == pytest.approx(VX[: len(trace)])
        assert any(states(note, "mcap recover") for note in notes)


def test_a_damaged_chunk_is_left_out_and_told(tmp_path, monkeypatch):
    path = chunked(tmp_path / "bag", monkeypatch, packed=True)
    data = bytearray(path.read_bytes())
    begin, end = chunks(data)[2]
    data[(begin + end) // 2 : end - 20] = bytes(end - 20 - (begin + end) // 2)
    for damaged in (path, tmp_path / "alone.mcap"):  # with the metadata, and without
        damaged.write_bytes(data)
        named = path.parent if damaged == path else damaged
        trace, notes = read(named)
        assert 300 < len(trace) < 400
        assert set(trace["vx"]) < set(VX)
        assert any(states(note, f"{len(trace)} messages", "/odom", "400") for note in notes)
        assert any(states(note, damaged.name, f"{end - begin:,} bytes") for note in notes)


@pytest.mark.parametrize("profile", [b"", b"ros1"])
def test_a_file_without_the_profile_of_ros_2_is_read_by_its_encodings(profile, tmp_path):
    data = (robot_logs.ros2(tmp_path / "bag", "MCAP") / "bag.mcap").read_bytes()
    size = int.from_bytes(data[9:17], "little")
    head = struct.pack("<I", len(profile)) + profile + data[17 + 4 + len(b"ros2") : 17 + size]
    path = tmp_path / "other.mcap"
    path.write_bytes(data[:9] + struct.pack("<Q", len(head)) + head + data[17 + size :])
    trace, notes = read(path)
    assert trace["vx"].tolist() == pytest.approx(VX)
    assert not any("closed" in note or "damaged" in note for note in notes)


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def text(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def test_messages_without_chunks_are_read_in_any_order(tmp_path):
    kind = "std_msgs/msg/Float64"
    definition, _ = HUMBLE.generate_msgdef(kind, ros_version=2)
    data = b"\x89MCAP0\r\n" + record(1, text(b"") + text(b""))
    data += record(
        3, struct.pack("<H", 1) + text(kind.encode()) + text(b"ros2msg") + text(definition.encode())
    )
    data += record(4, struct.pack("<HH", 1, 1) + text(b"/v") + text(b"cdr") + text(b""))
    data += record(4, struct.pack("<HH", 2, 0) + text(b"/json") + text(b"json") + text(b""))
    for number in (0, 2, 1, 3):
        raw = HUMBLE.serialize_cdr(HUMBLE.types[kind](data=float(number)), kind)
        stamp = EPOCH + number * 10**8
        data += record(5, struct.pack("<HIQQ", 1, number, stamp, stamp) + bytes(raw))
    path = tmp_path / "v.mcap"
    path.write_bytes(data + b"\x05\x2a\x00\x00\x00")
    found = logs.load(path, {"v": "/v.data"}, {"v": None})
    assert found.trace["v"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert any(states(note, "v.mcap", "4 messages", "5 bytes") for note in found.notes)
    (json,) = (topic for topic in summary(path).topics if topic.name == "/json")
    assert any(states(sentence, "/json", "json") for sentence in json.left_out)


def drives(folder: Path, packed=None) -> Path:
    """Write the drive into a ROS 1 bag of several chunks."""
    store = get_typestore(Stores.ROS1_NOETIC)
    path = folder / "drive.bag"
    writer = Ros1Writer(path)
    if packed:
        writer.set_compression(Ros1Writer.CompressionFormat[packed])
    writer.chunk_threshold = 2**13
    with writer:
        connections = {
            name: writer.add_connection(name, kind, typestore=store) for name, kind in TOPICS.items()
        }
        for received, topic, message in robot_logs._messages(store, 0, 0):
            writer.write(connections[topic], received, store.serialize_ros1(message, TOPICS[topic]))
    return path


@pytest.mark.parametrize("packed", [None, "LZ4", "BZ2"])
def test_the_whole_chunks_of_a_ros_1_bag_without_its_index_are_read(packed, tmp_path):
    path = drives(tmp_path, packed)
    data = path.read_bytes()
    lengths = []
    for part in (0.4, 0.7):
        path.write_bytes(data[: int(part * len(data))])
        trace, notes = read(path)
        assert trace["vx"].tolist() == pytest.approx(VX[: len(trace)])
        assert any(states(note, "drive.bag", "rosbag reindex", "bytes") for note in notes)
        lengths.append(len(trace))
    assert 100 < lengths[0] < lengths[1] < 300


def test_a_ros_1_bag_that_was_never_closed_is_read(tmp_path):
    path = drives(tmp_path)
    data = bytearray(path.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[place : place + 8], "little")
    data[place : place + 8] = bytes(8)
    path.write_bytes(data[:index])
    trace, notes = read(path)
    assert trace["vx"].tolist() == pytest.approx(VX)
    assert any(states(note, "drive.bag", "rosbag reindex") for note in notes)


@pytest.mark.parametrize(
    ("name", "way"),
    [("a.mcap", "mcap recover"), ("a.bag", "rosbag reindex"), ("a.db3", "sqlite3 a.db3 .recover")],
)
def test_a_file_without_a_whole_message_names_what_may_save_it(name, way, tmp_path):
    (tmp_path / name).write_bytes(b"\x89MCAP0\r\n" if name == "a.mcap" else b"#ROSBAG V2.0\n")
    with pytest.raises(TraceError, match=naming(name, way)):
        read(tmp_path / name)


def instance(store, kind: str):
    """Return a message with a value in every number, and one element in every sequence of messages."""

    def value(shape, content, name):
        if shape == 2:
            return instance(store, content)
        if shape == 1:
            text_, number = content[0] == "string", content[0] == "bool"
            return "abc" if text_ else bool(len(name) % 2) if number else len(name)
        (inner, held), length = content
        if inner == 2:
            return [instance(store, held) for _ in range(length if shape == 3 else 1)]
        if held[0] == "string":
            return ["a"] * (length if shape == 3 else 1)
        dtype = {"byte": "uint8", "char": "uint8"}.get(held[0], held[0])
        return np.ones(length if shape == 3 else 2, dtype)

    fields = store.fielddefs[kind][1]
    return store.types[kind](**{name: value(*held, name) for name, held in fields})


def changed() -> list[tuple[str, Stores]]:
    """Return every type of ROS 2 with a distribution for each of its definitions."""
    stores = [one for one in Stores if one.value.startswith("ros2_")]
    found: dict[str, dict[str, Stores]] = {}
    for one in stores:
        store = get_typestore(one)
        for kind in store.fielddefs:
            try:
                lines = store.generate_msgdef(kind, ros_version=2)[0].splitlines()
                fields = "\n".join(line for line in lines if "=" not in line or line.startswith("="))
                found.setdefault(kind, {})[fields] = one
            except Exception:  # rosbags cannot write some
                continue
    names = {"sensor_msgs", "geometry_msgs", "visualization_msgs", "shape_msgs", "std_msgs", "nav_msgs"}
    return [
        (kind, one)
        for kind, versions in found.items()
        if len(versions) > 1 and kind.split("/")[0] in names
        for one in versions.values()
    ]


def without_definitions(folder: Path, kind: str, store, distribution: str = "", count: int = 3) -> Path:
    """Write a bag as before Iron: it has no definitions of its messages."""
    with Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/topic", kind, typestore=store)
        for number in range(count):
            raw = store.serialize_cdr(instance(store, kind), kind)
            writer.write(connection, EPOCH + number * 10**8, raw)
    with sqlite3.connect(folder / f"{folder.name}.db3") as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3, ros_distro = ?", (distribution,))
    database.close()
    return folder


CHANGED = changed()


def test_range_is_among_the_types_that_changed():
    assert "sensor_msgs/msg/Range" in dict(CHANGED)


@pytest.mark.parametrize(("kind", "distribution"), CHANGED, ids=lambda one: getattr(one, "value", one))
def test_a_bag_without_definitions_is_read_by_the_one_that_fits(kind, distribution, tmp_path):
    store = get_typestore(distribution)
    bag = RosBag(without_definitions(tmp_path / "bag", kind, store))
    (head,) = bag.heads
    assert not head.faults
    (name, *_) = head.fields or [""]
    known = {field for field, _ in store.fielddefs[kind][1]}
    assert {field.split(".")[0] for field in head.fields} <= known
    if name:
        assert len(bag.read({"/topic": [name]}, "received")["/topic"]) == 3


def test_the_log_of_a_sonar_lists_only_what_the_bag_has(tmp_path, s2r):
    humble = without_definitions(tmp_path / "humble", "sensor_msgs/msg/Range", HUMBLE)
    jazzy = without_definitions(tmp_path / "jazzy", "sensor_msgs/msg/Range", get_typestore(Stores.ROS2_JAZZY))
    assert "variance" not in s2r("log", humble).stdout
    assert "variance" in s2r("log", jazzy).stdout
    found = logs.load(humble, {"d": "/topic.range"}, {"d": None}, joining=Joining(stamps="received"))
    assert found.trace["d"].tolist() == [len("range")] * 3


def test_a_message_that_no_definition_fits_is_named(tmp_path):
    bag = without_definitions(tmp_path / "bag", "sensor_msgs/msg/Range", HUMBLE)
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute("UPDATE messages SET data = x'00010000ff'")
    database.close()
    with pytest.raises(
        TraceError, match=naming("/topic", "sensor_msgs/msg/Range", "message 1", "Humble", "Iron")
    ):
        logs.load(bag, {"d": "/topic.range"}, {"d": None})
    (topic,) = summary(bag).topics
    assert any(
        states(one, "/topic", "sensor_msgs/msg/Range", "message 1", "Humble", "Iron")
        for one in topic.left_out
    )
    assert topic.messages == 3


def test_a_message_that_does_not_fit_its_definition_is_named_with_its_number(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "SQLITE3")
    with sqlite3.connect(bag / "bag.db3") as database:
        odom = "(SELECT id FROM messages WHERE topic_id = 1 ORDER BY timestamp LIMIT 1 OFFSET 6)"
        database.execute(f"UPDATE messages SET data = x'0001000001020304' WHERE id = {odom}")
    database.close()
    with pytest.raises(TraceError, match=naming("message 7", "/odom", "geometry_msgs/msg/TwistStamped")):
        read(bag)
    assert [topic.messages for topic in summary(bag).topics] == [400, 160]  # the others can be read


def states_of_joints(folder: Path, messages) -> Path:
    """Write joint states: (stamp [ms], joint → position)."""
    kind, types = "sensor_msgs/msg/JointState", HUMBLE.types
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=HUMBLE)
        for number, (at, joints) in enumerate(messages):
            stamp = EPOCH + at * 10**6
            time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
            message = types[kind](
                header=types["std_msgs/msg/Header"](stamp=time, frame_id=""),
                name=list(joints),
                position=np.array(list(joints.values()), dtype=float),
                velocity=np.zeros(0),
                effort=np.zeros(0),
            )
            writer.write(connection, stamp + number, HUMBLE.serialize_cdr(message, kind))
    return folder


@pytest.mark.parametrize("later", [0, 5])
def test_elements_of_several_senders_are_streams_of_their_own(later, tmp_path):
    rows = []
    for k in range(20):
        arm = {"a1": 0.1, "a2": 2.9 if k == 10 else np.nan if k == 3 else 0.2}
        rows += [(20 * k, arm), (20 * k + later, {"g": 0.02 * k})]
    bag = RosBag(states_of_joints(tmp_path / "bag", rows))
    names = [f"position.{joint}" for joint in ("a1", "a2", "g")]
    arm, gripper = bag.read({"/joint_states": names}, "header").values()
    assert {arm.name, gripper.name} == {"/joint_states"}
    assert [*arm.columns] == names[:2]
    assert [*gripper.columns] == names[2:]
    assert arm.stamps.tolist() == [EPOCH + 20_000_000 * k for k in range(20)]
    assert gripper.stamps.tolist() == [EPOCH + (20 * k + later) * 10**6 for k in range(20)]
    assert np.flatnonzero(np.isnan(arm.columns[names[1]].values)).tolist() == [3]
    assert gripper.columns[names[2]].values.tolist() == pytest.approx([0.02 * k for k in range(20)])
    assert sum(states(note, "20 messages", "/joint_states") for note in bag.notes) == 2


def test_elements_that_always_come_together_are_one_stream(tmp_path):
    bag = RosBag(states_of_joints(tmp_path / "bag", [(k, {"a": k, "b": -k}) for k in range(9)]))
    (key,) = bag.read({"/joint_states": ["position.a", "position.b"]}, "header")
    assert key == "/joint_states"


def test_an_element_that_has_no_value_is_named(tmp_path):
    bag = states_of_joints(tmp_path / "bag", [(k, {"a": k}) for k in range(9)])
    with pytest.raises(TraceError, match=naming("/joint_states.effort.a")):
        logs.load(bag, {"u": "/joint_states.effort.a"}, {"u": None})


def test_a_clock_may_be_an_element(tmp_path):
    rows = [(10 * k, {"a": k} if k % 3 else {"g": k}) for k in range(30)]
    bag = states_of_joints(tmp_path / "bag", rows)
    columns = {name: f"/joint_states.position.{name}" for name in "ag"}
    wanted = dict.fromkeys(columns)
    for name, count in (("a", 20), ("g", 9)):
        found = logs.load(bag, columns, wanted, joining=Joining(clock=name))
        assert len(found.trace) == count


KINDS = [
    "geometry_msgs/msg/TwistStamped",
    "std_msgs/msg/Bool",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/BatteryState",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/LaserScan",
    "std_msgs/msg/UInt64",
    "std_msgs/msg/Int8",
    "std_msgs/msg/Byte",
    "sensor_msgs/msg/NavSatFix",
    "geometry_msgs/msg/PolygonStamped",
]


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_numbers_decoded_together_are_those_of_each_message(kind, big, tmp_path):
    messages = [instance(HUMBLE, kind) for _ in range(4)]
    if kind == "std_msgs/msg/UInt64":
        messages[1].data = 2**63 + 5
    if hasattr(messages[0], "header"):
        messages[2].header.frame_id = "abcdefgh"  # the numbers of this message stand elsewhere
    if hasattr(messages[0], "position_covariance"):
        messages[3].position_covariance[4] = np.nan
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/topic", kind, typestore=HUMBLE)
        for number, message in enumerate(messages):
            raw = HUMBLE.serialize_cdr(message, kind, little_endian=not big)
            writer.write(connection, EPOCH + number, raw)
    bag = RosBag(tmp_path / "bag")
    (head,) = bag.heads
    found = bag.read({"/topic": head.fields}, "received")["/topic"].columns if head.fields else {}
    for name, column in found.items():
        for value, message in zip(column.values, messages, strict=True):
            expected = message
            for part in name.split("."):
                expected = getattr(expected, part)
            np.testing.assert_array_equal(value, expected)


def test_a_bag_is_closed_when_it_is_no_longer_used(tmp_path):
    path = killed(tmp_path)
    before = {*Path(os.environ.get("TMPDIR", "/tmp")).glob("s2r-*")}
    read(path)
    assert {*Path(os.environ.get("TMPDIR", "/tmp")).glob("s2r-*")} <= before


def test_a_ulog_that_ends_within_a_message_says_how_much_is_read(tmp_path):
    path = robot_logs.ulog(tmp_path / "cut.ulg")
    assert not logs.load(path, {"vx": "odom.vx"}, {"vx": None}).notes
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.7 * len(whole)) | 1])
    notes = logs.load(path, {"vx": "odom.vx"}, {"vx": None}).notes
    assert any("incomplete" in note and f"{len(path.read_bytes()):,}" in note for note in notes)


def test_a_file_of_a_split_bag_that_the_metadata_do_not_list_is_refused(tmp_path):
    bag = robot_logs.ros2(tmp_path / "bag", "MCAP")
    shutil.copy(bag / "bag.mcap", bag / "bag_1.mcap")
    with pytest.raises(TraceError, match=r"bag_1\.mcap"):
        logs.load(bag, {"vx": "/odom.twist.linear.x"}, {"vx": None})
