"""Logs of several topics as files of every format, written without s2r. Stamps of bags and of HDF5 are dates."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.logs import tables
from tests.logs.multirate import Log, Sent

EPOCH = 1_790_000_000 * 10**9
"""Definition: the date of time 0 in bags, and in HDF5 [ns since 1970]."""


@dataclass(frozen=True)
class Format:
    """A format of files.

    Args:
        write: writes a log into a folder, and returns the file and (topic, field) → the column's name.
        faults: the faults that a file of it can have, beside those of the values.
        one: whether a file holds one topic.
        joined: whether its rows belong to several topics, so that ``--join`` is needed.
        headers: whether each message has a stamp of its sender.
    """

    write: Callable[[Log, Path], tuple[Path, dict[tuple[str, str], str]]]
    faults: frozenset[str]
    one: bool = False
    joined: bool = False
    headers: bool = False


def _rows(log: Log) -> Iterator[tuple[int, Sent, int]]:
    """Return (time of receipt [ms], topic, number of its message) in the order of receipt."""
    rows = [(at, k, sent, n) for k, sent in enumerate(log.topics) for n, at in enumerate(sent.received)]
    for at, _, sent, number in sorted(rows, key=lambda row: (row[0], row[1], row[3])):
        yield at, sent, number


def _number(kind: str, value: float) -> Any:
    return {"real": float, "int": int, "bool": bool}[kind](value)


def _plain(log: Log, connect: Any, write: Any, store: Any, serialize: Any) -> dict[tuple[str, str], str]:
    """Write messages of one number, which have no header; each field is a topic of its own."""
    kinds = {"real": "std_msgs/msg/Float64", "int": "std_msgs/msg/Int32", "bool": "std_msgs/msg/Bool"}
    found, columns = {}, {}
    for sent in log.topics:
        for field, kind in sent.kinds.items():
            topic = f"/{sent.name}_{field}"
            found[sent.name, field] = connect(topic, kinds[kind])
            columns[sent.name, field] = f"{topic}.data"
    for _, sent, number in _rows(log):
        at = sent.stamps[number]
        assert at is not None
        for field, kind in sent.kinds.items():
            value = _number(kind, sent.values[field][number])
            message = store.types[kinds[kind]](data=value)
            write(found[sent.name, field], EPOCH + at * 10**6, serialize(message, kinds[kind]))
    return columns


def _stamped(log: Log, connect: Any, write: Any, store: Any, serialize: Any) -> dict[tuple[str, str], str]:
    """Write messages with headers; the fields are components of a vector."""
    kind, types = "geometry_msgs/msg/Vector3Stamped", store.types
    found = {sent.name: connect(f"/{sent.name}", kind) for sent in log.topics}
    for at, sent, number in _rows(log):
        stamp = sent.stamps[number]
        stamp = 0 if stamp is None else EPOCH + stamp * 10**6
        time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        more = {"seq": number} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
        header = types["std_msgs/msg/Header"](stamp=time, frame_id="base", **more)
        row = [sent.values[field][number] for field in sent.kinds]
        vector = types["geometry_msgs/msg/Vector3"](*[*row, 0.0, 0.0][:3])
        delayed = EPOCH + at * 10**6 + 2_000_000
        write(found[sent.name], delayed, serialize(types[kind](header=header, vector=vector), kind))
    return {
        (sent.name, field): f"/{sent.name}.vector.{'xyz'[k]}"
        for sent in log.topics
        for k, field in enumerate(sent.kinds)
    }


def ros2(plugin: str, messages: Any) -> Callable[[Log, Path], tuple[Path, dict[tuple[str, str], str]]]:
    """Return a writer of ROS 2 bags."""

    def write(log: Log, folder: Path) -> tuple[Path, dict[tuple[str, str], str]]:
        from rosbags.rosbag2 import Writer
        from rosbags.rosbag2.enums import StoragePlugin
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin[plugin]) as bag:
            columns = messages(
                log,
                lambda topic, kind: bag.add_connection(topic, kind, typestore=store),
                bag.write,
                store,
                store.serialize_cdr,
            )
        return folder / "bag", columns

    return write


def ros1(messages: Any) -> Callable[[Log, Path], tuple[Path, dict[tuple[str, str], str]]]:
    """Return a writer of ROS 1 bags."""

    def write(log: Log, folder: Path) -> tuple[Path, dict[tuple[str, str], str]]:
        from rosbags.rosbag1 import Writer
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC)
        with Writer(folder / "log.bag") as bag:
            columns = messages(
                log,
                lambda topic, kind: bag.add_connection(topic, kind, typestore=store),
                bag.write,
                store,
                store.serialize_ros1,
            )
        return folder / "log.bag", columns

    return write


def _shown(sent: Sent) -> list[int]:
    assert all(stamp is not None for stamp in sent.stamps)
    return [stamp for stamp in sent.stamps if stamp is not None]


def _typed(sent: Sent, field: str) -> np.ndarray:
    """Return the values of a field in an array of its kind."""
    kind = {"real": np.float64, "int": np.int32, "bool": np.uint8}[sent.kinds[field]]
    return np.array(sent.values[field]).astype(kind)


def ulog(log: Log, folder: Path) -> tuple[Path, dict[tuple[str, str], str]]:
    """Write a PX4 log: stamps in microseconds."""
    codes = {"real": ("double", "d"), "int": ("int32_t", "i"), "bool": ("uint8_t", "B")}

    def message(kind: bytes, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    written = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    for sent in log.topics:  # no padding: the largest first
        fields = sorted(sent.kinds, key=lambda field: "real int bool".index(sent.kinds[field]))
        fields = "".join(f"{codes[sent.kinds[field]][0]} {field};" for field in fields)
        written += message(b"F", f"{sent.name}:uint64_t timestamp;{fields}".encode())
    for number, sent in enumerate(log.topics):
        written += message(b"A", struct.pack("<BH", 0, number) + sent.name.encode())
    numbers = {sent.name: number for number, sent in enumerate(log.topics)}
    for _, sent, k in _rows(log):
        fields = sorted(sent.kinds, key=lambda field: "real int bool".index(sent.kinds[field]))
        data = struct.pack("<HQ", numbers[sent.name], 7_000_000 + 1000 * (sent.stamps[k] or 0))
        for field in fields:
            kind = sent.kinds[field]
            data += struct.pack("<" + codes[kind][1], _number(kind, sent.values[field][k]))
        written += message(b"D", data)
    (folder / "log.ulg").write_bytes(written)
    names = {(sent.name, field): f"{sent.name}.{field}" for sent in log.topics for field in sent.kinds}
    return folder / "log.ulg", names


def hdf5(log: Log, folder: Path) -> tuple[Path, dict[tuple[str, str], str]]:
    """Write a group for each topic: dates in nanoseconds."""
    import h5py

    with h5py.File(folder / "log.h5", "w") as stream:
        for sent in log.topics:
            stream[f"{sent.name}/t"] = EPOCH + np.array(_shown(sent), dtype=np.int64) * 10**6
            stream[f"{sent.name}/t"].attrs["units"] = "ns"
            for field in sent.kinds:
                stream[f"{sent.name}/{field}"] = _typed(sent, field)
    return folder / "log.h5", {
        (sent.name, field): f"{sent.name}.{field}" for sent in log.topics for field in sent.kinds
    }


def matlab(log: Log, folder: Path) -> tuple[Path, dict[tuple[str, str], str]]:
    """Write a structure for each topic: times in seconds."""
    from scipy.io import savemat

    content = {
        sent.name: {
            "t": np.array(_shown(sent)) / 1000,
            **{field: _typed(sent, field) for field in sent.kinds},
        }
        for sent in log.topics
    }
    savemat(folder / "log.mat", content)
    return folder / "log.mat", {
        (sent.name, field): f"{sent.name}.{field}" for sent in log.topics for field in sent.kinds
    }


def table(ending: str) -> Callable[[Log, Path], tuple[Path, dict[tuple[str, str], str]]]:
    """Return a writer of a table of one topic."""

    def write(log: Log, folder: Path) -> tuple[Path, dict[tuple[str, str], str]]:
        (sent,) = log.topics
        columns: dict[str, Any] = {"t": (np.array(_shown(sent)) / 1000).tolist()}
        for field in sent.kinds:
            columns[field] = [None if np.isnan(value) else value for value in sent.values[field]]
        path = tables.written(folder / f"log{ending}", columns)
        return path, {(sent.name, field): field for field in sent.kinds}

    return write


def joined(ending: str) -> Callable[[Log, Path], tuple[Path, dict[tuple[str, str], str]]]:
    """Return a writer of a table with empty cells: topics with one time share a row."""

    def write(log: Log, folder: Path) -> tuple[Path, dict[tuple[str, str], str]]:
        rows: list[tuple[int, dict[str, float]]] = []
        last: set[str] = set()
        for _, sent, number in _rows(log):
            cells = {f"{sent.name}/{field}": sent.values[field][number] for field in sent.kinds}
            stamp = sent.stamps[number]
            assert stamp is not None
            if rows and rows[-1][0] == stamp and sent.name not in last:
                rows[-1][1].update(cells)
                last.add(sent.name)
            else:
                rows.append((stamp, cells))
                last = {sent.name}
        names = [f"{sent.name}/{field}" for sent in log.topics for field in sent.kinds]
        columns: dict[str, Any] = {"t": [at / 1000 for at, _ in rows]}
        for name in names:
            cells = [row.get(name) for _, row in rows]
            columns[name] = [None if value is None or np.isnan(value) else value for value in cells]
        path = tables.written(folder / f"log{ending}", columns)
        return path, {
            (sent.name, field): f"{sent.name}/{field}" for sent in log.topics for field in sent.kinds
        }

    return write


_VALUES = frozenset(("gap", "late start", "early end"))
_ORDER = frozenset(("reset", "stall", "merged", "repeated", "both repeated"))
FORMATS = {
    "ros2.sqlite3": Format(ros2("SQLITE3", _plain), _VALUES | _ORDER),
    "ros2.mcap": Format(ros2("MCAP", _plain), _VALUES | _ORDER),
    "ros2.header": Format(
        ros2("MCAP", _stamped), _VALUES | _ORDER | {"late", "jump", "unset", "missing"}, headers=True
    ),
    "ros1.header": Format(
        ros1(_stamped), _VALUES | _ORDER | {"late", "jump", "unset", "missing"}, headers=True
    ),
    "ros1": Format(ros1(_plain), _VALUES | _ORDER),
    "ulog": Format(ulog, _VALUES | _ORDER | {"late", "missing"}),
    "hdf5": Format(hdf5, _VALUES | _ORDER | {"missing"}),
    "matlab": Format(matlab, _VALUES | _ORDER | {"missing"}),
    "csv": Format(table(".csv"), _VALUES | _ORDER | {"missing"}, one=True),
    "npz": Format(table(".npz"), _VALUES | _ORDER | {"missing"}, one=True),
    "parquet": Format(table(".parquet"), _VALUES | _ORDER | {"missing"}, one=True),
    "csv.join": Format(joined(".csv"), _VALUES | _ORDER | {"missing"}, joined=True),
    "parquet.join": Format(joined(".parquet"), _VALUES | _ORDER | {"missing"}, joined=True),
}
