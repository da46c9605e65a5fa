"""The files of a ROS bag as one bag of ``rosbags``, also where the recorder was killed.

A file is read by its index. Without an index, or where this fails, its whole records are read from begin to end. A
SQLite file with a journal (``-wal``, ``-journal``) is copied, and SQLite recovers the messages of the journal there.
Nothing is written beside the file. Import this module only with ``rosbags``.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from s2r_spec.base.errors import TraceError, one_of, shortened
from s2r_spec.base.printable import one_line
from s2r_spec.logs.topics.bag_parts import BY_PARTS, Parts, remedy
from s2r_spec.logs.topics.formats import METADATA

_JOURNALS = ("-wal", "-journal")
"""Definition: endings of SQLite's journals."""


@dataclass(frozen=True)
class Bag:
    """An open bag, with notes on files that are not complete.

    Args:
        reader: gives connections, and the definitions of messages that the bag holds.
        owner: gives raw messages of connections, in the order of their receipt in each file.
        by_parts: whether files were read from begin to end although they may have an index.
        listed: topic → number of its messages in ``metadata.yaml``, or in the file's index.
        source: where these numbers come from.
        distribution: of ROS, in lower case, as the recorder noted it; "" if it did not.
    """

    reader: AnyReader
    owner: Any
    by_parts: bool
    listed: Mapping[str, int]
    source: str
    distribution: str
    notes: tuple[str, ...]


def open_bag(path: Path, stack: ExitStack, by_parts: bool = False) -> Bag:
    """Open a bag, and close it with a stack; ``by_parts`` uses no index.

    Raises:
        TraceError: the bag has no message that can be read.
    """
    try:
        # Bags before Iron have no definitions; `definitions.py` finds the one that fits where distributions differ.
        reader = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))
        folder = _Folder(path, by_parts) if path.is_dir() else None
        files: list[Any] = [folder or _File(path, by_parts)]  # they have the methods of a reader
        reader.readers = files
        stack.enter_context(reader)
    except (TraceError, FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # rosbags' errors have no common base class
        raise unreadable_error(path, error) from None
    files = [*folder.storages] if folder else files
    known = [one.distribution for one in files if one.distribution]
    counts: dict[str, int] = defaultdict(int)
    for one in reader.connections:
        counts[one.topic] += one.msgcount
    return Bag(
        reader,
        folder or files[0],
        by_parts,
        folder.listed if folder else {} if files[0].parts else counts,
        METADATA if folder else "its index",
        (folder.metadata.ros_distro if folder else None) or (known[0] if known else ""),
        tuple(note for one in files for note in one.notes),
    )


def unreadable_error(path: Path, error: Exception) -> TraceError:
    """Return an error about a bag or a file of it, with what may help."""
    text = str(error).replace(str(path), path.name)
    reason = shortened(one_line(text) or type(error).__name__)
    help_ = f"`ros2 bag reindex {path}` writes {METADATA} anew"
    if not path.is_dir():
        help_ = f"`{remedy(path)}` may save its messages"
    return TraceError(f"this bag cannot be read: {reason}; {help_}")


class _Database(Sqlite3Reader):
    """A SQLite file; one with a journal is read from a copy, in which SQLite recovers its messages."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._original = path
        self._stack = ExitStack()
        self.notes: list[str] = []
        self.distribution = ""

    def open(self) -> None:
        journals = [self._original.with_name(self._original.name + ending) for ending in _JOURNALS]
        journals = [file for file in journals if file.is_file() and file.stat().st_size]
        try:
            if journals:
                self.path = self._recover(journals)
            super().open()
            assert self.dbconn
            with suppress(Exception):  # bags before Humble lack the table
                (self.distribution,) = self.dbconn.execute("SELECT ros_distro FROM schema").fetchone()  # type: ignore[misc]
        except BaseException:
            self._stack.close()
            raise
        if journals:
            names = one_of(file.name for file in journals)
            self.notes = [
                f"{self._original.name} was not closed by its recorder: {self.metadata.message_count:,} messages are "
                f"read, with those that SQLite recovers from {names}; later ones are unknown"
            ]

    def close(self) -> None:
        with self._stack:
            super().close()

    def _recover(self, journals: list[Path]) -> Path:
        folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="s2r-")))
        names = one_of(file.name for file in journals)
        try:
            for file in (self._original, *journals):
                shutil.copyfile(file, folder / file.name)
        except OSError as error:
            raise TraceError(
                f"{names} has messages that {self._original.name} lacks, and both cannot be copied to {folder.parent}: "
                f"{error.strerror}; `sqlite3 {self._original.name} 'PRAGMA wal_checkpoint(TRUNCATE)'` joins them"
            ) from None
        copy = folder / self._original.name
        with closing(sqlite3.connect(copy)) as database:  # the first query recovers
            database.execute("SELECT count(*) FROM sqlite_master").fetchone()
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        return copy


_INDEXED: dict[str, Callable[[Path], Any]] = {".mcap": McapReader, ".bag": Ros1Reader, ".db3": _Database}


class _File:
    """A file that is read by its index or, where it has none, by its whole parts; a storage and a reader of rosbags.

    Args:
        path: the file.
        by_parts: whether not to use its index.
    """

    def __init__(self, path: Path, by_parts: bool) -> None:
        self.path = path
        self._by_parts = by_parts
        self._storage: Any = None
        self.parts = False

    def open(self) -> None:
        ending = self.path.suffix.lower()
        reason: Exception = ValueError("it has no whole message")
        if not self._by_parts or ending not in BY_PARTS:
            try:
                self._storage = _INDEXED[ending](self.path)
                self._storage.open()
                return
            except (TraceError, PermissionError):
                raise
            except Exception as error:
                if ending not in BY_PARTS:
                    raise unreadable_error(self.path, error) from None
                reason = error
        with suppress(ValueError):  # it is no such file at all
            parts = Parts(self.path, *BY_PARTS[ending])
            parts.open()
            if parts.count:
                self._storage, self.parts = parts, True
                return
        raise unreadable_error(self.path, reason)

    def close(self) -> None:
        self._storage.close()

    def __getattr__(self, name: str) -> Any:
        """Return ``connections``, ``metadata`` or ``messages`` of the storage, or what else rosbags asks for."""
        return getattr(self._storage, name)

    def __enter__(self) -> _File:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def end_time(self) -> int:
        """Receipt of the last message [ns]; rosbags counts one nanosecond more."""
        storage = self._storage
        end = storage.end_time if isinstance(storage, Ros1Reader) else storage.metadata.end_time
        return int(end) - 1

    @property
    def notes(self) -> list[str]:
        return getattr(self._storage, "notes", [])

    @property
    def distribution(self) -> str:
        return getattr(self._storage, "distribution", "")


class _Folder(DirectoryReader):
    """The folder of a ROS 2 bag, whose topics are those of its files rather than those of ``metadata.yaml``."""

    def __init__(self, path: Path, by_parts: bool) -> None:
        super().__init__(path)
        self.listed: dict[str, int] = defaultdict(int)
        plugin: Any = partial(_File, by_parts=by_parts)
        self.STORAGE_PLUGINS = dict.fromkeys(super().STORAGE_PLUGINS, plugin)

    def __enter__(self) -> _Folder:
        if surplus := self._surplus():
            raise TraceError(
                f"{METADATA} does not list {one_of(surplus)}, which the folder holds; `ros2 bag reindex {self.path}` "
                f"lists all files, or move those of another bag away"
            )
        try:
            self.open()
        except Exception:
            if missing := [name for name in self._listed_files() if not (self.path / name).exists()]:
                raise TraceError(
                    f"{METADATA} lists {one_of(missing)}, and the folder lacks it; copy it, or `ros2 bag reindex "
                    f"{self.path}` to read the rest"
                ) from None
            raise
        digests = {(one.topic, one.msgtype): one.digest for one in self.connections}
        for one in self.connections:
            self.listed[one.topic] += one.msgcount
        self.connections = [
            one._replace(owner=self, digest=one.digest or digests.get((one.topic, one.msgtype), ""))
            for storage in self.storages
            for one in storage.connections
        ]
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def end_time(self) -> int:
        return max(file.end_time for file in self.storages if isinstance(file, _File))

    def _listed_files(self) -> list[str]:
        with suppress(Exception):  # then the metadata have another fault
            metadata = YAML(typ="safe").load((self.path / METADATA).read_text())
            return [
                Path(name).name for name in metadata["rosbag2_bagfile_information"]["relative_file_paths"]
            ]
        return []

    def _surplus(self) -> list[str]:
        listed = {name.removesuffix(".zstd") for name in self._listed_files()}
        files = sorted(one.name for one in Path(str(self.path)).iterdir() if one.suffix in (".db3", ".mcap"))
        return [name for name in files if name not in listed] if listed else []
