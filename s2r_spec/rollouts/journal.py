"""The journal of a run: every rollout is on disk before the next is asked for.

A run is a folder::

    spec.stl           the specification, as it was read
    journal.jsonl      line 1: what the run is; then one line per rollout
    traces/            <query>.<replicate>.npz, written before its line

Each line is flushed to the disk (fsync) before the search sees the outcome.
A last line that a crash cut short is dropped with a note, and that rollout is
run again; damage anywhere else is an error that names the line. Each line ends
with a CRC-32 of itself and all before it, so that a number that was changed or
a line that was taken out is noticed, too. It is no signature: it guards against
accidents. Journals of schema 1 have no checksums; they are read as they are.
"""

from __future__ import annotations

import json
import math
import os
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from s2r_spec import logs
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.trace import Trace

SCHEMA = "s2r.journal/2"
UNCHECKED = "s2r.journal/1"
FILE = "journal.jsonl"
SPEC_FILE = "spec.stl"
_CHECKED = re.compile(rb'(?P<body>.*), "crc32": "(?P<sum>[0-9a-f]{8})"\}')


class JournalError(UsageError):
    """The journal of a run cannot be used: it is missing, damaged, or of another run."""


@dataclass(frozen=True)
class Record:
    """One rollout as the journal keeps it.

    ``failure`` is a short word when the robot fell or the worker died, else
    None; ``rho`` is then the value that the spec declares.
    """

    query: int
    replicate: int
    params: dict[str, float]
    seed: int
    rho: float
    failure: str | None
    trace: str | None
    seconds: float


class Journal:
    """An open journal. Make one with :meth:`create` or :meth:`resume`."""

    def __init__(
        self,
        folder: Path,
        header: Mapping[str, Any],
        records: dict[tuple[int, int], Record],
        note: str,
        checksum: int | None,
    ) -> None:
        self.folder = folder
        self.header = dict(header)
        self.note = note
        self._records = records
        self._checksum = checksum  # of all lines so far; None in a journal that has none

    @classmethod
    def create(cls, folder: Path, header: Mapping[str, Any], texts: Mapping[str, str]) -> Journal:
        """Begin a run in a folder that has none, with these text files beside the journal.

        Raises:
            JournalError: the folder holds a run already, or cannot be written.
        """
        if cls.begun(folder):
            raise JournalError(
                f"{folder} holds a run already; go on with --resume {folder}, or choose another folder"
            )
        path = folder / FILE
        try:
            (folder / "traces").mkdir(parents=True, exist_ok=True)
            _hold(folder)
            for name, text in texts.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_text(text, encoding="utf-8", newline="")
                _sync(folder / name)
            # Whole or not at all: a run that was killed while it began is no run.
            path.unlink(missing_ok=True)
            line, checksum = _line({"schema": SCHEMA} | dict(header), 0)
            _append(path.with_suffix(".new"), line)
            path.with_suffix(".new").replace(path)
            _sync_folder(folder)
        except OSError as error:
            raise JournalError(f"cannot write the run to {folder}: {error.strerror or error}") from error
        return cls(folder, header, {}, "", checksum)

    @staticmethod
    def begun(folder: Path) -> bool:
        """Return whether the folder holds a journal with at least its first line."""
        try:
            with (folder / FILE).open("rb") as file:
                return file.readline().endswith(b"\n")
        except OSError:
            return False

    @classmethod
    def read(cls, folder: Path) -> Journal:
        """Read a run.

        Raises:
            JournalError: there is none, or a line other than the last is damaged.
        """
        path = folder / FILE
        try:
            data = path.read_bytes()
        except OSError as error:
            raise JournalError(f"no run to resume at {folder}: {error.strerror or error} ({path})") from error
        # A line counts once its newline is on disk; what follows the last newline was cut short.
        whole, _, rest = data.rpartition(b"\n")
        note = ""
        if rest:
            note = f"{path}: the last line was cut short; it is dropped, and its rollout will be run again"
        texts = whole.split(b"\n") if whole else []
        lines = [_parse(path, number, text) for number, text in enumerate(texts, 1)]
        if not lines or lines[0].get("schema") not in (SCHEMA, UNCHECKED):
            raise JournalError(f"{path}:1: this is not a journal of schema {SCHEMA}; begin a new run")
        checksum = None if lines[0]["schema"] == UNCHECKED else _check(path, texts)
        records: dict[tuple[int, int], Record] = {}
        for number, line in enumerate(lines[1:], 2):
            try:
                record = Record(**{key: value for key, value in line.items() if key != "crc32"})
            except TypeError as error:
                raise JournalError(f"{path}:{number}: not a rollout record: {error}") from error
            if not (isinstance(record.rho, float | int) and isinstance(record.params, dict)):
                raise JournalError(
                    f"{path}:{number}: not a rollout record: ρ must be a number, params an object"
                )
            if (record.query, record.replicate) in records:
                raise JournalError(
                    f"{path}:{number}: rollout {record.query}.{record.replicate} is there twice; "
                    f"two processes must have written to this run"
                )
            records[record.query, record.replicate] = record
        header = {key: value for key, value in lines[0].items() if key not in ("schema", "crc32")}
        return cls(folder, header, records, note, checksum)

    @classmethod
    def resume(cls, folder: Path, header: Mapping[str, Any]) -> Journal:
        """Read a run, cut off a damaged last line, and check that it is the same run.

        Raises:
            JournalError: as :meth:`read`; or a field of the header differs, which is named with both values.
        """
        journal = cls.read(folder)
        try:
            _hold(folder)
        except OSError as error:
            raise JournalError(f"cannot write to {folder}: {error.strerror or error}") from error
        asked = json.loads(json.dumps(dict(header)))
        for key in sorted(asked.keys() | journal.header.keys()):
            recorded, now = journal.header.get(key), asked.get(key)
            if recorded != now:
                raise JournalError(
                    f"{folder} is another run: its {key} is {_short(recorded)}, now it is {_short(now)}; "
                    f"a certificate cannot mix the two"
                )
        if journal.note:
            path = folder / FILE
            data = path.read_bytes()
            with path.open("r+b") as file:
                file.truncate(data.rfind(b"\n") + 1)
                os.fsync(file.fileno())
        return journal

    def __len__(self) -> int:
        return len(self._records)

    def get(self, query: int, replicate: int) -> Record | None:
        """Return a rollout that was done before, or None."""
        return self._records.get((query, replicate))

    def records(self) -> list[Record]:
        """Return every rollout, ordered by query and replicate."""
        return [self._records[key] for key in sorted(self._records)]

    def keep(self, key: tuple[int, int], trace: Trace | None) -> Path:
        """Write a trace that cannot be scored beside the journal, and return where."""
        path = self.folder / "unscored" / f"{key[0]:05d}.{key[1]:04d}.npz"
        if trace is not None:
            path.parent.mkdir(exist_ok=True)
            logs.write(trace, path)
            _sync(path)
        return path

    def append(self, record: Record, trace: Trace | None) -> Record:
        """Write the trace, then the line; both are on disk when this returns.

        Raises:
            JournalError: the disk is full or the folder cannot be written; what was recorded before is untouched.
        """
        if not math.isfinite(record.rho):
            raise JournalError(
                f"ρ of rollout {record.query}.{record.replicate} is {record.rho}: it cannot be recorded"
            )
        try:
            if trace is not None:
                name = f"traces/{record.query:05d}.{record.replicate:04d}.npz"
                record = replace(record, trace=name)
                _write(trace, self.folder / name)
            line, checksum = _line(vars(record), self._checksum)
            _append(self.folder / FILE, line)
        except OSError as error:
            raise JournalError(
                f"cannot write to {self.folder}: {error.strerror or error}; what was recorded before is kept, "
                f"go on with --resume {self.folder}"
            ) from error
        self._checksum = checksum
        self._records[record.query, record.replicate] = record
        return record


# Folders that this process writes to, by their locks; the system lets go of them when it ends.
_held: dict[Path, int] = {}


def _hold(folder: Path) -> None:
    """Hold a run's folder for this process until it ends: two writers would mix their rollouts.

    Raises:
        JournalError: another process holds it.
    """
    try:
        import fcntl
    except ImportError:  # not a POSIX system: nothing to hold it with
        return
    if folder.resolve() in _held:
        return
    handle = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise JournalError(
            f"{folder} is being written by another process; wait for it, or stop it"
        ) from error
    _held[folder.resolve()] = handle


def _parse(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        value = json.loads(line)
    except ValueError as error:
        raise JournalError(
            f"{path}:{number}: damaged line ({error}); restore it from a copy, or begin a new run"
        ) from None
    if not isinstance(value, dict):
        raise JournalError(f"{path}:{number}: not an object; restore it from a copy, or begin a new run")
    return value


def _line(value: Mapping[str, Any], before: int | None) -> tuple[bytes, int | None]:
    """Return a line of the journal and its checksum, from that of the line before; without one if that is None."""
    body = json.dumps(value, allow_nan=False).encode()[:-1]
    if before is None:
        return body + b"}", None
    checksum = zlib.crc32(body, before)
    return body + b', "crc32": "%08x"}' % checksum, checksum


def _check(path: Path, lines: Sequence[bytes]) -> int:
    """Return the checksum of all lines.

    Raises:
        JournalError: a line is not as it was written.
    """
    checksum = 0
    for number, line in enumerate(lines, 1):
        match = _CHECKED.fullmatch(line)
        if match is not None:
            checksum = zlib.crc32(match["body"], checksum)
        if match is None or int(match["sum"], 16) != checksum:
            raise JournalError(
                f"{path}:{number}: the checksum does not fit: this line was changed after it was written, or one "
                f"before it was taken out; restore it from a copy, or begin a new run"
            )
    return checksum


def _append(path: Path, line: bytes) -> None:
    start = path.stat().st_size if path.exists() else 0
    with path.open("ab") as file:
        try:
            file.write(line + b"\n")
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            os.truncate(path, start)  # a half line on a full disk would join with the next one
            raise


def _write(trace: Trace, path: Path) -> None:
    """Write a trace, onto the disk.

    Raises:
        OSError: it cannot be written there.
        TraceError: the format cannot hold it.
    """
    try:
        logs.write(trace, path)
    except TraceError as error:
        raise error.__context__ if isinstance(error.__context__, OSError) else error from None
    _sync(path)


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
