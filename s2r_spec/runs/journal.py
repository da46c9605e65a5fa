"""The journal of a run: every rollout is on disk before the next one starts.

A run is a folder::

    spec.stl           the specification, unchanged; see spec_files.py
    journal.jsonl      line 1: the header of the run; then one line per rollout
    traces/            <query>.<replicate>.npz, written before its line
    void/, raw/        machines only: traces of void rollouts, and recordings other than traces

The journal of a machine has further kinds of lines; see machine_journal.py. A run that was resumed under another
stopping rule has a line for it; see stop_rule.py.

Each line is flushed to the disk (fsync) before the search uses the outcome. If a crash cut the last line short, a
note says so, the line is dropped, and its rollout runs again. Damage anywhere else is an error that names the line.

Each line ends with the CRC-32 of itself and all lines before it, and holds the CRC-32 of its trace file. So a changed
number, a missing line and an exchanged trace are found. The checksums detect accidents; they are not signatures.
Journals of schema 1 have no checksums, and older ones of schema 2 have none of traces; both can be read.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from s2r_spec import logs
from s2r_spec.base.errors import TraceError, one_of
from s2r_spec.base.files import onto_disk
from s2r_spec.recordings import reading_rule
from s2r_spec.runs import lines, machine_journal, stop_rule
from s2r_spec.runs.layout import FILE, SYSTEMS, run_of
from s2r_spec.runs.lines import JournalError
from s2r_spec.runs.machine_journal import Attempt, Attempts, Void
from s2r_spec.trace import Trace

SCHEMA = "s2r.journal/2"
UNCHECKED = "s2r.journal/1"
LOCK = "lock"


@dataclass(frozen=True)
class Record:
    """One rollout in the journal.

    ``failure`` is a short word if the robot fell or the worker died, else None. With a failure, ``rho`` is the value
    that the spec declares.
    """

    query: int
    replicate: int
    params: dict[str, float]
    seed: int
    rho: float
    failure: str | None
    trace: str | None
    seconds: float


@dataclass(frozen=True)
class _Entry:
    """A rollout, the number of its line, and the checksum of its trace file, if any."""

    record: Record
    line: int
    trace_sum: str | None


class Journal:
    """An open journal, made by :meth:`create`, :meth:`read` or :meth:`resume`."""

    def __init__(
        self,
        folder: Path,
        header: Mapping[str, Any],
        entries: dict[tuple[int, int], _Entry],
        note: str,
        checksum: int | None,
        attempts: Attempts | None = None,
        count: int = 1,
    ) -> None:
        self.folder = folder
        self.header = dict(header)
        self.note = note
        self._entries = entries
        self._checksum = checksum  # of all lines so far; None in a journal of schema 1
        self._attempts = attempts or Attempts()
        self._lines = count

    @property
    def path(self) -> Path:
        """File of the journal."""
        return self.folder / FILE

    @classmethod
    def create(cls, folder: Path, header: Mapping[str, Any], texts: Mapping[str, str]) -> Journal:
        """Begin a run in a folder, with these text files beside the journal.

        Raises:
            JournalError: the folder already holds a run, or cannot be written.
        """
        if cls.begun(folder):
            raise JournalError(
                f"{folder} already holds a run; go on with --resume {run_of(folder, header)}, or choose another folder"
            )
        path = folder / FILE
        if path.exists() and not path.is_file():
            raise JournalError(f"cannot write the run to {folder}: {path} is not a file")
        try:
            (folder / "traces").mkdir(parents=True, exist_ok=True)
            _lock(folder)
            for name, text in texts.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_text(text, encoding="utf-8", newline="")
                onto_disk(folder / name)
            # The file appears whole or not at all, so a kill at this point leaves no run.
            path.unlink(missing_ok=True)
            path.with_suffix(".new").unlink(missing_ok=True)
            line, checksum = lines.encode({"schema": SCHEMA} | dict(header), 0)
            _append(path.with_suffix(".new"), line)
            path.with_suffix(".new").replace(path)
            onto_disk(folder)
        except OSError as error:
            raise JournalError(f"cannot write the run to {folder}: {error.strerror or error}") from error
        return cls(folder, header, {}, "", checksum)

    @staticmethod
    def begun(folder: Path) -> bool:
        """Return whether the folder holds a journal with at least its first line."""
        path = folder / FILE
        try:
            if not path.is_file():
                return False
            with path.open("rb") as file:
                first = file.readline(lines.LONGEST)
            # A start of a run that was killed cannot leave a line longer than any header.
            return first.endswith(b"\n") or len(first) == lines.LONGEST
        except OSError:
            return False

    @staticmethod
    def exists(folder: Path) -> bool:
        """Return whether a run began in the folder, even if a kill left its journal empty."""
        return (folder / FILE).exists() or (folder / LOCK).exists()

    @staticmethod
    def header_in(folder: Path) -> dict[str, Any]:
        """Return the header of the journal in a folder without reading its other lines; empty if there is none.

        Raises:
            JournalError: the first line is damaged.
        """
        if not Journal.begun(folder):
            return {}
        with (folder / FILE).open("rb") as file:
            return lines.parse(folder / FILE, 1, file.readline(lines.LONGEST))

    @classmethod
    def read(cls, folder: Path) -> Journal:
        """Read a run.

        Raises:
            JournalError: there is no run, or a line other than the last is damaged.
        """
        path = folder / FILE
        try:
            # A line counts once its line feed is on disk; text after the last line feed is an incomplete line.
            texts, rest = lines.read(path)
        except OSError as error:
            raise JournalError(f"no run to resume at {folder}: {error.strerror or error} ({path})") from error
        note = ""
        if rest:
            note = f"{path}: the last line is incomplete; s2r drops it and runs its rollout again"
        parsed = [lines.parse(path, number, text) for number, text in enumerate(texts, 1)]
        if not parsed or parsed[0].get("schema") not in (SCHEMA, UNCHECKED):
            raise JournalError(
                f"{path}:1: the schema is not {SCHEMA}, so this is not an s2r journal; begin a new run"
            )
        checksum = None if parsed[0]["schema"] == UNCHECKED else lines.check(path, texts)
        entries: dict[tuple[int, int], _Entry] = {}
        attempts = Attempts()
        header = {key: value for key, value in parsed[0].items() if key not in ("schema", "crc32")}
        for number, line in enumerate(parsed[1:], 2):
            if line.get("kind") == stop_rule.KIND:
                header = _with_rule(path, number, header, line)
                continue
            if "kind" in line:
                attempts.read(path, number, line)
                continue
            record, trace_sum = _record(path, number, line)
            key = record.query, record.replicate
            if key in entries:
                raise JournalError(
                    f"{path}:{number}: line {entries[key].line} already holds rollout {key[0]}.{key[1]}, so two "
                    f"processes wrote to this run; restore it from a copy, or begin a new run"
                )
            entries[key] = _Entry(record, number, trace_sum)
            attempts.end(key)
        return cls(folder, header, entries, note, checksum, attempts, len(parsed))

    @classmethod
    def resume(cls, folder: Path, header: Mapping[str, Any]) -> Journal:
        """Read a run, cut off an incomplete last line, and check that the header is the same.

        The stopping rule may be another one; the journal gets a line for it.

        Raises:
            JournalError: as :meth:`read`; or a field of the header differs, or the rule by which logs are read. The
                message gives both values.
        """
        journal = cls.read(folder)
        try:
            _lock(folder)
            (folder / "traces").mkdir(exist_ok=True)
        except OSError as error:
            raise JournalError(f"cannot write to {folder}: {error.strerror or error}") from error
        current = json.loads(json.dumps(dict(header)))
        for backend, before, now in reading_rule.changes(journal.header, current, SYSTEMS):
            raise JournalError(
                f"the logs of {backend} in {folder} were read by reading rule {before}, and this s2r has rule {now}. "
                f"Begin a new run, or resume with the s2r that began this one"
            )
        for key in sorted(current.keys() | journal.header.keys()):
            recorded, now = journal.header.get(key), current.get(key)
            if recorded != now and key != stop_rule.KIND:
                raise JournalError(
                    f"{folder} is another run: its {key} is {lines.excerpt(recorded)}, now it is {lines.excerpt(now)}; "
                    f"a certificate cannot mix the two, so begin a new run"
                )
        if journal.note:
            try:
                data = journal.path.read_bytes()
                with journal.path.open("r+b") as file:
                    file.truncate(data.rfind(b"\n") + 1)
                    os.fsync(file.fileno())
            except OSError as error:
                raise JournalError(f"cannot write to {journal.path}: {error.strerror or error}") from error
        if (rule := stop_rule.stop_of(current)) != stop_rule.stop_of(journal.header):
            journal._write("the stopping rule", stop_rule.line_of(rule))
            journal.header = stop_rule.with_line(journal.header, stop_rule.line_of(rule))
        return journal

    def __len__(self) -> int:
        return len(self._entries)

    def get(self, query: int, replicate: int) -> Record | None:
        """Return a recorded rollout, or None."""
        entry = self._entries.get((query, replicate))
        return None if entry is None else entry.record

    def has(self, query: int, replicates: int) -> bool:
        """Return whether the first rollouts of a query are all recorded."""
        return all((query, replicate) in self._entries for replicate in range(replicates))

    def records(self) -> list[Record]:
        """Return every rollout, ordered by query and replicate."""
        return [self._entries[key].record for key in sorted(self._entries)]

    @property
    def voids(self) -> tuple[Void, ...]:
        """Every void rollout, in the order of the journal."""
        return tuple(void for void, _ in self._attempts.voids)

    @property
    def open(self) -> tuple[Attempt, ...]:
        """Attempts that began and have no end in the journal: one still runs, or s2r was killed in it."""
        return tuple(self._attempts.open.values())

    def place(self, record: Record) -> str:
        """Return the file and the line of a rollout, for a message."""
        return f"{self.path}:{self._entries[record.query, record.replicate].line}"

    def check_traces(self) -> None:
        """Check every trace file against its checksum in the journal.

        A missing file is not an error, because the journal holds ρ. Older journals have no checksums of traces.

        Raises:
            JournalError: a file differs from its checksum.
        """
        traces = [
            (entry.record.trace, entry.trace_sum, self.place(entry.record))
            for entry in self._entries.values()
        ]
        traces += [(void.trace, trace_sum, str(self.path)) for void, trace_sum in self._attempts.voids]
        for trace, trace_sum, place in traces:
            if trace is None or trace_sum is None:
                continue
            path = self.folder / trace
            try:
                changed = path.exists() and (not path.is_file() or _sum(path) != trace_sum)
            except OSError as error:
                raise JournalError(f"cannot read {path}: {error.strerror or error}") from error
            if changed:
                raise JournalError(
                    f"{path} was changed: its checksum differs from the one in {place}; restore both files from a "
                    f"copy, or begin a new run"
                )

    def keep(self, key: tuple[int, int], trace: Trace | None) -> Path:
        """Write a trace without a ρ beside the journal, and return its path.

        Raises:
            JournalError: the file cannot be written.
        """
        path = self.folder / "unscored" / f"{key[0]:05d}.{key[1]:04d}.npz"
        if trace is not None:
            try:
                path.parent.mkdir(exist_ok=True)
                _write(trace, path)
            except OSError as error:
                raise JournalError(f"cannot write {path}: {error.strerror or error}") from error
        return path

    def append(self, record: Record, trace: Trace | None) -> Record:
        """Write the trace, then the line; both are on disk when this returns.

        Raises:
            JournalError: the disk is full, or the folder cannot be written. Earlier records stay as they are.
        """
        if not math.isfinite(record.rho):
            raise JournalError(
                f"ρ of rollout {record.query}.{record.replicate} is {record.rho}; it must be a finite number"
            )
        name = _trace_file(record.query, record.replicate)
        if trace is not None:
            record = replace(record, trace=name)
        rollout = f"rollout {record.query}.{record.replicate}"
        trace_sum = self._write(rollout, vars(record), trace, name)
        self._entries[record.query, record.replicate] = _Entry(record, self._lines, trace_sum)
        self._attempts.end((record.query, record.replicate))
        return record

    def begin(
        self,
        key: tuple[int, int],
        params: Mapping[str, float],
        seed: int,
        answers: Mapping[str, str] | None = None,
    ) -> Attempt:
        """Write that a rollout is about to begin on a machine; see :mod:`s2r_spec.runs.machine_journal`.

        Raises:
            JournalError: as :meth:`append`.
        """
        attempt = self._attempts.next(key, params, seed, answers or {})
        self._write(f"rollout {key[0]}.{key[1]}", machine_journal.begun_line(attempt))
        self._attempts.begin(attempt)
        return attempt

    def void(self, void: Void, trace: Trace | None) -> Void:
        """Write a void rollout, with its trace if there is one.

        Raises:
            JournalError: as :meth:`append`.
        """
        name = machine_journal.trace_file(void.rollout)
        void = replace(
            void,
            trace=None if trace is None else name,
            reason=void.reason[: machine_journal.LONGEST_REASON],
            seconds=round(void.seconds, 4),
        )
        rollout = f"rollout {void.rollout.query}.{void.rollout.replicate}"
        trace_sum = self._write(rollout, machine_journal.void_line(void), trace, name)
        self._attempts.void(void, trace_sum)
        return void

    def killed(self, attempt: Attempt, reason: str) -> Void:
        """Write that s2r was killed during an attempt; a trace without a line becomes the trace of the void rollout.

        Raises:
            JournalError: as :meth:`append`.
        """
        path = self.folder / _trace_file(*attempt.key)
        try:
            trace = logs.read(path) if path.is_file() else None
        except TraceError:
            trace = None  # the kill left it incomplete
        return self.void(Void(attempt, machine_journal.KILLED, reason, None, 0.0), trace)

    def not_begun(self, attempt: Attempt, reason: str) -> None:
        """Write that an announced rollout never began.

        Raises:
            JournalError: as :meth:`append`.
        """
        rollout = f"rollout {attempt.query}.{attempt.replicate}"
        self._write(rollout, machine_journal.not_begun_line(attempt, reason))
        self._attempts.end(attempt.key)

    def _write(
        self, rollout: str, values: Mapping[str, Any], trace: Trace | None = None, name: str = ""
    ) -> str | None:
        """Write a trace to the file ``name`` of the folder, then a line; return the checksum of the file.

        Raises:
            JournalError: the disk is full, or the folder cannot be written. Earlier records stay as they are.
        """
        trace_sum = None
        try:
            if trace is not None:
                (self.folder / name).parent.mkdir(exist_ok=True)
                _write(trace, self.folder / name)
                trace_sum = _sum(self.folder / name)
            more = {} if trace_sum is None else {lines.TRACE_SUM: trace_sum}
            line, checksum = lines.encode(dict(values) | more, self._checksum)
            if len(line) > lines.LONGEST:
                raise JournalError(
                    f"the line of {rollout} has {len(line)} bytes, more than {lines.LONGEST}: shorten its failure "
                    f"or its parameters"
                )
            _append(self.path, line)
        except OSError as error:
            raise JournalError(
                f"cannot write to {self.folder}: {error.strerror or error}; all earlier rollouts are kept, go on with "
                f"--resume {run_of(self.folder, self.header)}"
            ) from error
        self._checksum = checksum
        self._lines += 1
        return trace_sum


def _with_rule(path: Path, number: int, header: Mapping[str, Any], line: Mapping[str, Any]) -> dict[str, Any]:
    """Return a header after a line that changes the stopping rule.

    Raises:
        JournalError: there is no such rule.
    """
    if line.get(stop_rule.KIND) not in stop_rule.STOPS:
        raise JournalError(
            f"{path}:{number}: stop must be one of {one_of(stop_rule.STOPS)}, not "
            f"{lines.excerpt(line.get(stop_rule.KIND))}; restore the journal from a copy, or begin a new run"
        )
    return stop_rule.with_line(header, line)


def _trace_file(query: int, replicate: int) -> str:
    return f"traces/{query:05d}.{replicate:04d}.npz"


def _record(path: Path, number: int, line: Mapping[str, Any]) -> tuple[Record, str | None]:
    values = {key: value for key, value in line.items() if key not in ("crc32", lines.TRACE_SUM)}
    wrong = lines.fault(values, lines.ROLLOUT)
    if not wrong and (unknown := sorted(values.keys() - lines.ROLLOUT.keys())):
        wrong = f"{unknown[0]!r} is an unknown field"
    if not wrong and not lines.is_text_or_none(line.get(lines.TRACE_SUM)):
        wrong = f"{lines.TRACE_SUM} must be a string"
    if wrong:
        raise JournalError(
            f"{path}:{number}: not the record of a rollout: {wrong}; restore the journal from a copy, or begin a new "
            f"run"
        )
    return Record(**values), line.get(lines.TRACE_SUM)


def _sum(path: Path) -> str:
    checksum = 0
    with path.open("rb") as file:
        while part := file.read(1 << 20):
            checksum = zlib.crc32(part, checksum)
    return f"{checksum:08x}"


# Locked folder → file descriptor of its lock; the system releases the locks when this process ends.
_locks: dict[Path, int] = {}


def _lock(folder: Path) -> None:
    """Lock a run's folder until this process ends: two writers would mix their rollouts.

    Raises:
        JournalError: another process holds the lock.
    """
    try:
        import fcntl
    except ImportError:  # not a POSIX system: there is no such lock
        return
    if folder.resolve() in _locks:
        return
    handle = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise JournalError(
            f"another process is writing to the run in {folder}; wait for it, or stop it"
        ) from error
    _locks[folder.resolve()] = handle


def _append(path: Path, line: bytes) -> None:
    start = path.stat().st_size if path.exists() else 0
    with path.open("ab") as file:
        try:
            file.write(line + b"\n")
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            os.truncate(path, start)  # half a line on a full disk would join the next one
            raise


def _write(trace: Trace, path: Path) -> None:
    """Write a trace, and flush it to the disk.

    Raises:
        OSError: the file cannot be written.
        TraceError: the format cannot hold the trace.
    """
    try:
        logs.write(trace, path)
    except TraceError as error:
        raise error.__context__ if isinstance(error.__context__, OSError) else error from None
