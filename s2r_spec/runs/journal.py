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
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from s2r_spec import logs
from s2r_spec.base.errors import TraceError, one_of
from s2r_spec.base.files import onto_disk
from s2r_spec.recordings import reading_rule
from s2r_spec.runs import disk, lines, machine_journal, stop_rule
from s2r_spec.runs.layout import FILE, SYSTEMS, run_of
from s2r_spec.runs.lines import JournalError
from s2r_spec.runs.lock import LOCK, lock
from s2r_spec.runs.machine_journal import Attempt, Attempts, Void
from s2r_spec.trace import Trace

SCHEMA = "s2r.journal/2"


@dataclass(frozen=True)
class Record(lines.Rollout):
    """One rollout in the journal.

    ``failure`` is a short word if the robot fell or the worker died, else None. With a failure, ``rho`` is the value
    that the spec declares.
    """

    params: dict[str, float]
    seed: int
    rho: float
    failure: str | None
    trace: str | None
    seconds: float


@dataclass(frozen=True)
class _Entry:
    record: Record
    line: int
    trace_sum: str | None


class Journal:
    """An open journal, made by :meth:`create`, :meth:`read` or :meth:`resume`.

    Each method that writes raises a JournalError if the disk is full or the folder cannot be written. Earlier records
    stay as they are.
    """

    def __init__(self, folder: Path, header: Mapping[str, Any], checksum: int, note: str = "") -> None:
        self.folder, self.path, self.header, self.note = folder, folder / FILE, dict(header), note
        self._entries: dict[lines.Key, _Entry] = {}
        self._attempts, self._lines = Attempts(), 1
        self._checksum = checksum  # of all lines so far

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
        with disk.naming_errors(f"write the run to {folder}"):
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
            disk.append(path.with_suffix(".new"), line)
            path.with_suffix(".new").replace(path)
            onto_disk(folder)
        return cls(folder, header, checksum)

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

        A JournalError says that the first line is damaged.
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
        note = f"{path}: the last line is incomplete; s2r drops it and runs its rollout again" if rest else ""
        parsed = [lines.parse(path, number, text) for number, text in enumerate(texts, 1)]
        if not parsed or parsed[0].get("schema") != SCHEMA:
            raise JournalError(
                f"{path}:1: the schema is not {SCHEMA}, so this is not an s2r journal; begin a new run"
            )
        header = {key: value for key, value in parsed[0].items() if key not in ("schema", lines.SUM)}
        journal = cls(folder, header, lines.check(path, texts), note)
        for number, line in enumerate(parsed[1:], 2):
            journal._read_line(number, line)
        journal._lines = len(parsed)
        return journal

    def _read_line(self, number: int, line: Mapping[str, Any]) -> None:
        if line.get("kind") == stop_rule.KIND:
            stop = line.get(stop_rule.KIND)
            if stop not in stop_rule.STOPS:
                words = f"stop must be one of {one_of(stop_rule.STOPS)}, not {lines.excerpt(stop)}"
                raise lines.damage(self.path, number, words)
            self._change_rule(str(stop))
            return
        if "kind" in line:
            self._attempts.read(self.path, number, line)
            return
        values = lines.read_fields(self.path, number, line, lines.ROLLOUT, "not the record of a rollout: ")
        record = Record(**values)
        if before := self._entries.get(record.key):
            raise JournalError(
                f"{self.path}:{number}: line {before.line} already holds rollout {record.name}, so two "
                f"processes wrote to this run; restore it from a copy, or begin a new run"
            )
        self._entries[record.key] = _Entry(record, number, line.get(lines.TRACE_SUM))
        self._attempts.end(record.key)

    def _change_rule(self, stop: str) -> None:
        self.header.pop(stop_rule.KIND, None)
        self.header |= stop_rule.header_fields(stop)

    @classmethod
    def resume(cls, folder: Path, header: Mapping[str, Any]) -> Journal:
        """Read a run, cut off an incomplete last line, and check that the header is the same.

        The stopping rule may be another one; the journal gets a line for it.

        Raises:
            JournalError: as :meth:`read`; or a field of the header differs, or the rule by which logs are read. The
                message gives both values.
        """
        journal = cls.read(folder)
        with disk.naming_errors(f"write to {folder}"):
            _lock(folder)
            (folder / "traces").mkdir(exist_ok=True)
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
            with disk.naming_errors(f"write to {journal.path}"):
                data = journal.path.read_bytes()
                with journal.path.open("r+b") as file:
                    file.truncate(data.rfind(b"\n") + 1)
                    os.fsync(file.fileno())
        if (rule := stop_rule.stop_of(current)) != stop_rule.stop_of(journal.header):
            journal._write("the stopping rule", {"kind": stop_rule.KIND, stop_rule.KIND: rule})
            journal._change_rule(rule)
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
        return f"{self.path}:{self.line(record)}"

    def line(self, record: Record) -> int:
        """Return the number of a rollout's line."""
        return self._entries[record.key].line

    def check_traces(self) -> None:
        """Check every trace file against its checksum in the journal.

        A missing file is not an error, because the journal holds ρ.

        Raises:
            JournalError: a file differs from its checksum.
        """
        entries = self._entries.values()
        traces = [(entry.record.trace, entry.trace_sum, self.place(entry.record)) for entry in entries]
        traces += [(void.trace, trace_sum, str(self.path)) for void, trace_sum in self._attempts.voids]
        for trace, trace_sum, place in traces:
            if trace is None or trace_sum is None:
                continue
            path = self.folder / trace
            with disk.naming_errors(f"read {path}"):
                changed = path.exists() and (not path.is_file() or disk.checksum(path) != trace_sum)
            if changed:
                raise JournalError(
                    f"{path} was changed: its checksum differs from the one in {place}; restore both files from a "
                    f"copy, or begin a new run"
                )

    def keep(self, key: tuple[int, int], trace: Trace | None) -> Path:
        """Write a trace without a ρ beside the journal, and return its path."""
        path = self.folder / "unscored" / f"{key[0]:05d}.{key[1]:04d}.npz"
        if trace is not None:
            with disk.naming_errors(f"write {path}"):
                path.parent.mkdir(exist_ok=True)
                disk.write_trace(trace, path)
        return path

    def append(self, record: Record, trace: Trace | None) -> Record:
        """Write the trace, then the line; both are on disk when this returns.

        Raises:
            JournalError: ρ is not finite.
        """
        if not math.isfinite(record.rho):
            raise JournalError(f"ρ of rollout {record.name} is {record.rho}; it must be a finite number")
        name = _trace_file(*record.key)
        if trace is not None:
            record = replace(record, trace=name)
        trace_sum = self._write(f"rollout {record.name}", vars(record), trace, name)
        self._entries[record.key] = _Entry(record, self._lines, trace_sum)
        self._attempts.end(record.key)
        return record

    def begin(
        self, key: lines.Key, params: Mapping[str, float], seed: int, answers: Mapping[str, str] | None = None
    ) -> Attempt:
        """Write that a rollout is about to begin on a machine; see :mod:`s2r_spec.runs.machine_journal`."""
        number = self._attempts.counts.get(key, 0) + 1
        attempt = Attempt(*key, number, dict(params), seed, dict(answers or {}))
        self._write(f"rollout {attempt.name}", attempt.begun_line())
        self._attempts.begin(attempt)
        return attempt

    def void(self, void: Void, trace: Trace | None) -> Void:
        """Write a void rollout, with its trace if there is one."""
        name = void.rollout.trace_file
        void = replace(
            void,
            trace=None if trace is None else name,
            reason=void.reason[: machine_journal.LONGEST_REASON],
            seconds=round(void.seconds, 4),
        )
        trace_sum = self._write(f"rollout {void.rollout.name}", void.line(), trace, name)
        self._attempts.void(void, trace_sum)
        return void

    def killed(self, attempt: Attempt, reason: str) -> Void:
        """Write that s2r was killed during an attempt; a trace without a line becomes the trace of the void rollout."""
        path = self.folder / _trace_file(*attempt.key)
        try:
            trace = logs.read(path) if path.is_file() else None
        except TraceError:
            trace = None  # the kill left it incomplete
        return self.void(Void(attempt, machine_journal.KILLED, reason, None, 0.0), trace)

    def not_begun(self, attempt: Attempt, reason: str) -> None:
        """Write that an announced rollout never began."""
        self._write(f"rollout {attempt.name}", attempt.not_begun_line(reason))
        self._attempts.end(attempt.key)

    def _write(
        self, rollout: str, values: Mapping[str, Any], trace: Trace | None = None, name: str = ""
    ) -> str | None:
        """Write a trace to the file ``name`` of the folder, then a line; return the checksum of the file."""

        def kept() -> str:
            return f"; all earlier rollouts are kept, go on with --resume {run_of(self.folder, self.header)}"

        trace_sum = None
        with disk.naming_errors(f"write to {self.folder}", kept):
            if trace is not None:
                (self.folder / name).parent.mkdir(exist_ok=True)
                disk.write_trace(trace, self.folder / name)
                trace_sum = disk.checksum(self.folder / name)
            more = {} if trace_sum is None else {lines.TRACE_SUM: trace_sum}
            line, checksum = lines.encode(dict(values) | more, self._checksum)
            if len(line) > lines.LONGEST:
                raise JournalError(
                    f"the line of {rollout} has {len(line)} bytes, more than {lines.LONGEST}: shorten its failure "
                    f"or its parameters"
                )
            disk.append(self.path, line)
        self._checksum = checksum
        self._lines += 1
        return trace_sum


def _trace_file(query: int, replicate: int) -> str:
    return f"traces/{query:05d}.{replicate:04d}.npz"


def _lock(folder: Path) -> None:
    held = f"another process is writing to the run in {folder}; wait for it, or stop it"
    lock(folder, JournalError(held))
