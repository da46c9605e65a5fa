"""One drive of a robot, written in every format that robots write: 50 Hz velocity, 20 Hz command, which steps at 3.2 s.

The velocity is vx = 0.3 (1 − exp(−(t − 3.2)/0.1)) m/s after the step. Stamps of bags are dates in nanoseconds.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

EPOCH = 1_790_000_000 * 10**9
STEP = 3.2
VX_NS = np.arange(400) * 20_000_000
CMD_NS = np.arange(160) * 50_000_000
VX = np.where(VX_NS < STEP * 1e9, 0.0, 0.3 * (1.0 - np.exp(-(VX_NS * 1e-9 - STEP) / 0.1)))
CMD = np.where(CMD_NS < STEP * 1e9, 0.0, 0.3)

SPEC = """\
signal vx {m/s}
param vd {m/s} in [0, 0.5]
require reaches: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.05 {m/s})
"""
RHO = 0.05 - 0.3 * float(np.exp(-0.5 / 0.1))
"""ρ of ``reaches`` from the step on [m/s]: the greatest distance is at the window's begin."""


def _messages(store, header_shift: int, received_shift: int, idle: bool = True):
    """Return [(received [ns], topic, message)] in the order of receipt; shifts of stamps and of receipts [ns].

    Without ``idle`` the command has no message before its step.
    """
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]

    def twist(x):
        return types["geometry_msgs/msg/Twist"](
            linear=vector(x=x, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0)
        )

    def header(stamp, number):
        time = types["builtin_interfaces/msg/Time"](sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
        kind = types["std_msgs/msg/Header"]
        more = {"seq": number} if "seq" in kind.__dataclass_fields__ else {}
        return kind(stamp=time, frame_id="base", **more)

    rows = []
    stamped = types["geometry_msgs/msg/TwistStamped"]
    for number, (at, value) in enumerate(zip(VX_NS.tolist(), VX.tolist(), strict=True)):
        message = stamped(header=header(EPOCH + at + header_shift, number), twist=twist(value))
        rows.append((EPOCH + at + received_shift, "/odom", message))
    for at, value in zip(CMD_NS.tolist(), CMD.tolist(), strict=True):
        if idle or value:
            rows.append((EPOCH + at, "/cmd_vel", twist(value)))
    return sorted(rows, key=lambda row: row[0])


TOPICS = {"/odom": "geometry_msgs/msg/TwistStamped", "/cmd_vel": "geometry_msgs/msg/Twist"}


def ros2(
    folder: Path, plugin: str, header_shift: int = 0, received_shift: int = 0, idle: bool = True
) -> Path:
    """Write a ROS 2 bag, by sqlite3 or MCAP."""
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        connections = {
            name: writer.add_connection(name, kind, typestore=store) for name, kind in TOPICS.items()
        }
        for received, topic, message in _messages(store, header_shift, received_shift, idle):
            writer.write(connections[topic], received, store.serialize_cdr(message, TOPICS[topic]))
    return folder


def ros1(file: Path) -> Path:
    """Write a ROS 1 bag."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(file) as writer:
        connections = {
            name: writer.add_connection(name, kind, typestore=store) for name, kind in TOPICS.items()
        }
        for received, topic, message in _messages(store, 0, 0):
            writer.write(connections[topic], received, store.serialize_ros1(message, TOPICS[topic]))
    return file


def matlab(file: Path) -> Path:
    """Write two structures with times."""
    from scipy.io import savemat

    savemat(
        file,
        {"odom": {"t": VX_NS * 1e-9, "vx": VX[:, None]}, "cmd": {"time": CMD_NS[:, None] * 1e-9, "vx": CMD}},
    )
    return file


def hdf5(file: Path) -> Path:
    """Write two groups with times."""
    import h5py

    with h5py.File(file, "w") as stream:
        stream["odom/timestamp"] = EPOCH + VX_NS
        stream["odom/timestamp"].attrs["units"] = "ns"
        stream["odom/vx"] = VX
        stream["odom/vx"].attrs["units"] = "m/s"
        stream["cmd/t"] = EPOCH + CMD_NS
        stream["cmd/t"].attrs["units"] = "ns"
        stream["cmd/vx"] = CMD
    return file


def ulog(file: Path) -> Path:
    """Write a PX4 log, byte for byte as its documentation says (https://docs.px4.io/main/en/dev_log/ulog_file_format)."""

    def message(kind: bytes, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    written = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    written += message(b"B", bytes(40))
    written += message(b"F", b"odom:uint64_t timestamp;double vx;")
    written += message(b"F", b"cmd:uint64_t timestamp;double vx;")
    written += message(b"A", struct.pack("<BH", 0, 0) + b"odom") + message(
        b"A", struct.pack("<BH", 0, 1) + b"cmd"
    )
    rows = [(at, 0, value) for at, value in zip(VX_NS, VX, strict=True)]
    rows += [(at, 1, value) for at, value in zip(CMD_NS, CMD, strict=True)]
    for at, number, value in sorted(rows):
        written += message(b"D", struct.pack("<HQd", number, 7_000_000 + int(at) // 1000, value))
    file.write_bytes(written)
    return file


def plotjuggler(file: Path) -> Path:
    """Write a table with one row for each stamp, with empty cells, as PlotJuggler exports it."""
    cells: dict[int, list[str]] = {}
    for place, (stamps, values) in enumerate(((VX_NS, VX), (CMD_NS, CMD))):
        for at, value in zip(stamps.tolist(), values.tolist(), strict=True):
            cells.setdefault(at, ["", ""])[place] = repr(value)
    rows = [f"{(EPOCH + at) / 1e9:.6f},{','.join(row)}" for at, row in sorted(cells.items())]
    file.write_text("\n".join(["__time,/odom/vx,/cmd/vx", *rows, ""]))
    return file


EXAMPLE = Path(__file__).parents[2] / "specs" / "traces" / "drive.mcap"
"""The log that s2r ships. Nothing measured it: :func:`example` makes it."""
COMMANDS = ((0.0, 0.0), (3.2, 0.3), (5.5, 0.0), (7.1, -0.2), (9.4, 0.0), (11.0, 0.25), (13.3, 0.0))
"""Commands of the shipped log: (from [s], velocity [m/s])."""


def example(file: Path) -> Path:
    """Write the shipped log: three steps of the command, of which the last one overshoots."""
    from shutil import move
    from tempfile import TemporaryDirectory

    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types

    def twist(x):
        vector, still = types["geometry_msgs/msg/Vector3"], (0.0, 0.0, 0.0)
        return types[TOPICS["/cmd_vel"]](linear=vector(x, 0.0, 0.0), angular=vector(*still))

    rows = []
    position = velocity = command = 0.0
    for tick in range(15_000):  # 1 kHz: a mass on a spring to its command, well damped but in the last step
        now = tick / 1000
        command = [value for begin, value in COMMANDS if begin <= now][-1]
        damping = 0.45 if now > 10.0 else 0.9
        velocity += 1e-3 * (400.0 * (command - position) - 2.0 * damping * 20.0 * velocity)
        position += 1e-3 * velocity
        at = EPOCH + tick * 10**6
        if tick % 20 == 0:
            time = types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
            header = types["std_msgs/msg/Header"](stamp=time, frame_id="base")
            rows.append((at, "/odom", types[TOPICS["/odom"]](header=header, twist=twist(position))))
        if tick % 50 == 0:
            rows.append((at, "/cmd_vel", twist(command)))
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "drive"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            made = {name: writer.add_connection(name, kind, typestore=store) for name, kind in TOPICS.items()}
            for at, topic, message in rows:
                writer.write(made[topic], at, store.serialize_cdr(message, TOPICS[topic]))
        move(bag / "drive.mcap", file)
    return file


def joints(folder: Path, orders) -> Path:
    """Write joint states whose joints stand in another order from message to message: joint k is at k rad."""
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind, types = "sensor_msgs/msg/JointState", store.types
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for k, order in enumerate(orders):
            at = EPOCH + k * 10_000_000
            time = types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
            message = types[kind](
                header=types["std_msgs/msg/Header"](stamp=time, frame_id=""),
                name=[f"leg/{joint}" for joint in order],
                position=np.array(order, dtype=np.float64),
                velocity=np.zeros(0),
                effort=np.zeros(0),
            )
            writer.write(connection, at, store.serialize_cdr(message, kind))
    return folder


def two_clocks(folder: Path) -> Path:
    """Write odometry stamped with dates, and an IMU stamped with the seconds of a simulation."""
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind, types = "geometry_msgs/msg/TwistStamped", store.types
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, begins in (("/odom", EPOCH), ("/imu", 5 * 10**9)):
            connection = writer.add_connection(topic, kind, typestore=store)
            for k in range(100):
                at = begins + k * 10_000_000
                time = types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
                message = types[kind](
                    header=types["std_msgs/msg/Header"](stamp=time, frame_id=""),
                    twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
                )
                writer.write(connection, EPOCH + k * 10_000_000, store.serialize_cdr(message, kind))
    return folder


def lerobot(file: Path, episodes: int = 3) -> Path:
    """Write a table as LeRobot's format 3.0: the episodes one after the other, each with times from 0 on."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    count, period = 100, 1 / 50
    state = [[0.3, 0.1 * episode + 0.001 * k] for episode in range(episodes) for k in range(count)]
    table = {
        "observation.state": pa.array(state, pa.list_(pa.float32(), 2)),
        "action": pa.array([[0.3]] * (episodes * count), pa.list_(pa.float32(), 1)),
        "timestamp": pa.array([k * period for _ in range(episodes) for k in range(count)], pa.float32()),
        "episode_index": pa.array([episode for episode in range(episodes) for _ in range(count)]),
        "task": pa.array(["walk"] * (episodes * count)),
    }
    pq.write_table(pa.table(table), file)
    return file


GAP = 2.0
"""Pause between the rollouts of one bag [s]."""


def bag_of(rollouts, folder: Path, command: str = "on") -> Path:
    """Write rollouts into one ROS 2 bag (MCAP), with a pause between them, and return the bag.

    Every channel is a topic, and so is every parameter, with one message for each rollout.

    Args:
        rollouts: (parameters, trace) of each.
        folder: the new bag.
        command: name of the topic that is 1 during a rollout and 0 between them.
    """
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    number, vector = "std_msgs/msg/Float64", "std_msgs/msg/Float64MultiArray"
    layout = store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)

    def message(value):
        if np.ndim(value):
            return vector, store.types[vector](layout=layout, data=np.asarray(value, dtype=np.float64))
        return number, store.types[number](data=float(value))

    rows = []
    start = EPOCH
    for params, trace in rollouts:
        stamps = start + np.rint(trace.times * 1e9).astype(np.int64)
        first = {name: values[0] for name, values in trace.channels.items()}
        rows += [
            (int(stamps[0]) - 10**9, f"/{name}", value) for name, value in {**first, command: 0.0}.items()
        ]
        rows += [(int(stamps[0]), f"/{name}", value) for name, value in {**params, command: 1.0}.items()]
        for k, at in enumerate(stamps.tolist()):
            rows += [(at, f"/{name}", values[k]) for name, values in trace.channels.items()]
        start = int(stamps[-1]) + int(GAP * 1e9)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for at, topic, value in rows:
            kind, content = message(value)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], at, store.serialize_cdr(content, kind))
    return folder
