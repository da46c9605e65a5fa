"""The journal of a run: every rollout is on disk before the next is asked for.

A run is a folder::

    spec.stl           the specification, as it was read; see kept.py
    journal.jsonl      line 1: what the run is; then one line per rollout
    traces/            <query>.<replicate>.npz, written before its line
    void/, raw/        of a machine: traces of void rollouts, and what else the backend recorded

The journal of a machine has more kinds of lines: see attempts.py.
Each line is flushed to the disk (fsync) before the search sees the outcome.
A last line that a crash cut short is dropped with a note, and that rollout is
run again; damage anywhere else is an error that names the line. Each line ends
with a CRC-32 of itself and all before it, and has the CRC-32 of its trace's
file, so that a number that was changed, a line that was taken out or a trace
that was exchanged is noticed, too. They are no signatures: they guard against
accidents. Journals of schema 1 have no checksums, older ones of schema 2 none
of traces; they are read as they are.
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
from s2r_spec.errors import TraceError
from s2r_spec.files import onto_disk
from s2r_spec.rollouts import attempts, lines
from s2r_spec.rollouts.attempts import Attempts, Begun, Void
from s2r_spec.rollouts.layout import run_of
from s2r_spec.rollouts.lines import JournalError
from s2r_spec.trace import Trace

SCHEMA = "s2r.journal/2"
UNCHECKED = "s2r.journal/1"
FILE = "journal.jsonl"
LOCK = "lock"


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


@dataclass(frozen=True)
class _Kept:
    """A rollout, the number of its line, and the checksum of its trace's file if it has one."""

    record: Record
    line: int
    trace_sum: str | None


class Journal:
    """An open journal. Make one with :meth:`create` or :meth:`resume`."""

    def __init__(
        self,
        folder: Path,
        header: Mapping[str, Any],
        kept: dict[tuple[int, int], _Kept],
        note: str,
        checksum: int | None,
        attempted: Attempts | None = None,
        count: int = 1,
    ) -> None:
        self.folder = folder
        self.header = dict(header)
        self.note = note
        self._kept = kept
        self._checksum = checksum  # of all lines so far; None in a journal that has none
        self._attempts = attempted or Attempts()
        self._lines = count

    @property
    def path(self) -> Path:
        """Its file."""
        return self.folder / FILE

    @classmethod
    def create(cls, folder: Path, header: Mapping[str, Any], texts: Mapping[str, str]) -> Journal:
        """Begin a run in a folder that has none, with these text files beside the journal.

        Raises:
            JournalError: the folder holds a run already, or cannot be written.
        """
        if cls.begun(folder):
            raise JournalError(
                f"{folder} holds a run already; go on with --resume {run_of(folder, header)}, or choose another folder"
            )
        path = folder / FILE
        if path.exists() and not path.is_file():
            raise JournalError(f"cannot write the run to {folder}: {path} is not a file")
        try:
            (folder / "traces").mkdir(parents=True, exist_ok=True)
            _hold(folder)
            for name, text in texts.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_text(text, encoding="utf-8", newline="")
                onto_disk(folder / name)
            # Whole or not at all: a run that was killed while it began is no run.
            path.unlink(missing_ok=True)
            path.with_suffix(".new").unlink(missing_ok=True)
            line, checksum = lines.written({"schema": SCHEMA} | dict(header), 0)
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
            # What is longer than any first line was not left by a run that was killed while it began.
            return first.endswith(b"\n") or len(first) == lines.LONGEST
        except OSError:
            return False

    @staticmethod
    def found(folder: Path) -> bool:
        """Return whether a run was begun in the folder, even if it was killed before its journal had a line."""
        return (folder / FILE).exists() or (folder / LOCK).exists()

    @staticmethod
    def header_in(folder: Path) -> dict[str, Any]:
        """Return the header of the journal in a folder, of which nothing else is read; empty if none is begun there.

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
            JournalError: there is none, or a line other than the last is damaged.
        """
        path = folder / FILE
        try:
            # A line counts once its newline is on disk; what follows the last newline was cut short.
            texts, rest = lines.read(path)
        except OSError as error:
            raise JournalError(f"no run to resume at {folder}: {error.strerror or error} ({path})") from error
        note = ""
        if rest:
            note = f"{path}: the last line was cut short; it is dropped, and its rollout will be run again"
        parsed = [lines.parse(path, number, text) for number, text in enumerate(texts, 1)]
        if not parsed or parsed[0].get("schema") not in (SCHEMA, UNCHECKED):
            raise JournalError(f"{path}:1: this is not a journal of schema {SCHEMA}; begin a new run")
        checksum = None if parsed[0]["schema"] == UNCHECKED else lines.check(path, texts)
        kept: dict[tuple[int, int], _Kept] = {}
        attempted = Attempts()
        for number, line in enumerate(parsed[1:], 2):
            if "kind" in line:
                attempted.read(path, number, line)
                continue
            record, trace_sum = _record(path, number, line)
            key = record.query, record.replicate
            if key in kept:
                raise JournalError(
                    f"{path}:{number}: rollout {key[0]}.{key[1]} is there twice; "
                    f"two processes must have written to this run"
                )
            kept[key] = _Kept(record, number, trace_sum)
            attempted.end(key)
        header = {key: value for key, value in parsed[0].items() if key not in ("schema", "crc32")}
        return cls(folder, header, kept, note, checksum, attempted, len(parsed))

    @classmethod
    def resume(cls, folder: Path, header: Mapping[str, Any]) -> Journal:
        """Read a run, cut off a damaged last line, and check that it is the same run.

        Raises:
            JournalError: as :meth:`read`; or a field of the header differs, which is named with both values.
        """
        journal = cls.read(folder)
        try:
            _hold(folder)
            (folder / "traces").mkdir(exist_ok=True)
        except OSError as error:
            raise JournalError(f"cannot write to {folder}: {error.strerror or error}") from error
        asked = json.loads(json.dumps(dict(header)))
        for key in sorted(asked.keys() | journal.header.keys()):
            recorded, now = journal.header.get(key), asked.get(key)
            if recorded != now:
                raise JournalError(
                    f"{folder} is another run: its {key} is {lines.shown(recorded)}, now it is {lines.shown(now)}; "
                    f"a certificate cannot mix the two"
                )
        if journal.note:
            try:
                data = journal.path.read_bytes()
                with journal.path.open("r+b") as file:
                    file.truncate(data.rfind(b"\n") + 1)
                    os.fsync(file.fileno())
            except OSError as error:
                raise JournalError(f"cannot write to {journal.path}: {error.strerror or error}") from error
        return journal

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, query: int, replicate: int) -> Record | None:
        """Return a rollout that was done before, or None."""
        kept = self._kept.get((query, replicate))
        return None if kept is None else kept.record

    def records(self) -> list[Record]:
        """Return every rollout, ordered by query and replicate."""
        return [self._kept[key].record for key in sorted(self._kept)]

    @property
    def voids(self) -> tuple[Void, ...]:
        """Every rollout that was void, in the order in which they were recorded."""
        return tuple(void for void, _ in self._attempts.voids)

    @property
    def open(self) -> tuple[Begun, ...]:
        """Rollouts that were begun, and of which the journal says no more: one runs, or s2r was killed in it."""
        return tuple(self._attempts.open.values())

    def place(self, record: Record) -> str:
        """Return file and line of a rollout, for a sentence."""
        return f"{self.path}:{self._kept[record.query, record.replicate].line}"

    def check_traces(self) -> None:
        """See that every trace that is there is the one that was recorded.

        One that is gone is no lie: ρ is in the journal. Traces of older journals have no checksum.

        Raises:
            JournalError: a file is another one.
        """
        found = [(kept.record.trace, kept.trace_sum, self.place(kept.record)) for kept in self._kept.values()]
        found += [(void.trace, trace_sum, str(self.path)) for void, trace_sum in self._attempts.voids]
        for trace, trace_sum, place in found:
            if trace is None or trace_sum is None:
                continue
            path = self.folder / trace
            try:
                changed = path.exists() and (not path.is_file() or _sum(path) != trace_sum)
            except OSError as error:
                raise JournalError(f"cannot read {path}: {error.strerror or error}") from error
            if changed:
                raise JournalError(
                    f"{path} is not the trace that was recorded: its checksum differs from "
                    f"{place}; restore both from a copy, or begin a new run"
                )

    def keep(self, key: tuple[int, int], trace: Trace | None) -> Path:
        """Write a trace that cannot be scored beside the journal, and return where.

        Raises:
            JournalError: it cannot be written.
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
            JournalError: the disk is full or the folder cannot be written; what was recorded before is untouched.
        """
        if not math.isfinite(record.rho):
            raise JournalError(
                f"ρ of rollout {record.query}.{record.replicate} is {record.rho}: it cannot be recorded"
            )
        name = _trace_file(record.query, record.replicate)
        if trace is not None:
            record = replace(record, trace=name)
        what = f"rollout {record.query}.{record.replicate}"
        trace_sum = self._write(what, vars(record), trace, name)
        self._kept[record.query, record.replicate] = _Kept(record, self._lines, trace_sum)
        self._attempts.end((record.query, record.replicate))
        return record

    def begin(
        self,
        key: tuple[int, int],
        params: Mapping[str, float],
        seed: int,
        answers: Mapping[str, str] | None = None,
    ) -> Begun:
        """Write that a machine is about to be given a rollout; see :mod:`s2r_spec.rollouts.attempts`.

        Raises:
            JournalError: as :meth:`append`.
        """
        begun = self._attempts.next(key, params, seed, answers or {})
        self._write(f"rollout {key[0]}.{key[1]}", attempts.begun_line(begun))
        self._attempts.begin(begun)
        return begun

    def void(self, void: Void, trace: Trace | None) -> Void:
        """Write that a rollout was void, and what was recorded of it.

        Raises:
            JournalError: as :meth:`append`.
        """
        name = attempts.trace_file(void.begun)
        void = replace(
            void,
            trace=None if trace is None else name,
            reason=void.reason[: attempts.LONGEST_REASON],
            seconds=round(void.seconds, 4),
        )
        which = f"rollout {void.begun.query}.{void.begun.replicate}"
        trace_sum = self._write(which, attempts.void_line(void), trace, name)
        self._attempts.void(void, trace_sum)
        return void

    def killed(self, begun: Begun, reason: str) -> Void:
        """Write that s2r was killed during a rollout; a trace that it left without a line is kept as the void one's.

        Raises:
            JournalError: as :meth:`append`.
        """
        left = self.folder / _trace_file(*begun.key)
        try:
            trace = logs.read(left) if left.is_file() else None
        except TraceError:
            trace = None  # the kill cut it short
        return self.void(Void(begun, attempts.KILLED, reason, None, 0.0), trace)

    def not_begun(self, begun: Begun, reason: str) -> None:
        """Write that a rollout that was to begin never did.

        Raises:
            JournalError: as :meth:`append`.
        """
        which = f"rollout {begun.query}.{begun.replicate}"
        self._write(which, attempts.not_begun_line(begun, reason))
        self._attempts.end(begun.key)

    def _write(
        self, what: str, values: Mapping[str, Any], trace: Trace | None = None, name: str = ""
    ) -> str | None:
        """Write a trace to the file ``name`` of the folder, then a line; return the checksum of the file.

        Raises:
            JournalError: the disk is full or the folder cannot be written; what was recorded before is untouched.
        """
        trace_sum = None
        try:
            if trace is not None:
                (self.folder / name).parent.mkdir(exist_ok=True)
                _write(trace, self.folder / name)
                trace_sum = _sum(self.folder / name)
            more = {} if trace_sum is None else {lines.TRACE_SUM: trace_sum}
            line, checksum = lines.written(dict(values) | more, self._checksum)
            if len(line) > lines.LONGEST:
                raise JournalError(
                    f"the line of {what} has {len(line)} bytes: its failure or its "
                    f"parameters are too long to be recorded"
                )
            _append(self.path, line)
        except OSError as error:
            raise JournalError(
                f"cannot write to {self.folder}: {error.strerror or error}; what was recorded before is kept, "
                f"go on with --resume {run_of(self.folder, self.header)}"
            ) from error
        self._checksum = checksum
        self._lines += 1
        return trace_sum


def _trace_file(query: int, replicate: int) -> str:
    """Return where the trace of a rollout lies in its run's folder."""
    return f"traces/{query:05d}.{replicate:04d}.npz"


def _record(path: Path, number: int, line: Mapping[str, Any]) -> tuple[Record, str | None]:
    """Return a line's rollout, and the checksum of its trace's file if it has one.

    Raises:
        JournalError: a field is missing, unknown, or not of its type.
    """
    values = {key: value for key, value in line.items() if key not in ("crc32", lines.TRACE_SUM)}
    wrong = lines.fault(values, lines.ROLLOUT)
    if not wrong and (unknown := sorted(values.keys() - lines.ROLLOUT.keys())):
        wrong = f"{unknown[0]!r} is no field of it"
    if not wrong and not lines.is_text_or_none(line.get(lines.TRACE_SUM)):
        wrong = f"{lines.TRACE_SUM} must be a text"
    if wrong:
        raise JournalError(
            f"{path}:{number}: not a rollout record: {wrong}; restore it from a copy, or begin a new run"
        )
    return Record(**values), line.get(lines.TRACE_SUM)


def _sum(path: Path) -> str:
    """Return the CRC-32 of a file, as hex digits."""
    checksum = 0
    with path.open("rb") as file:
        while part := file.read(1 << 20):
            checksum = zlib.crc32(part, checksum)
    return f"{checksum:08x}"


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
    handle = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise JournalError(
            f"{folder} is being written by another process; wait for it, or stop it"
        ) from error
    _held[folder.resolve()] = handle


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
