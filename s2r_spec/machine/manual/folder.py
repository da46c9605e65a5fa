"""The folder of tests that a person runs: the pending test, its log, and the recorded rollouts.

    rollouts.csv  0001.csv  0002.npz …   recorded rollouts, in the form that ``log:FOLDER`` reads
    incoming/      the person puts a log here
    originals/     accepted logs, unchanged, as <id>-<name>
    refused/       refused logs, unchanged
    manual.json    channels and parameters of the specification
    next.json      the pending test and its state
    skipped.txt    tests that did not begin because the robot was broken

Every file is replaced whole or not at all. A trace is written before its row. A kill in between leaves a trace without
a row; the next start removes it and makes it again from the log.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from s2r_spec import logs
from s2r_spec.backend import Channel, Parameter
from s2r_spec.base.errors import TraceError, TraceNote, UsageError
from s2r_spec.base.files import replacing, save
from s2r_spec.machine.manual import table
from s2r_spec.machine.manual.checks import within_horizon
from s2r_spec.recordings.log_folder import TABLE, digest
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.runs.lock import lock, release
from s2r_spec.trace import Trace

SCHEMA = "s2r.manual/1"
INCOMING, ORIGINALS, REFUSED = "incoming", "originals", "refused"
DECLARED, NEXT, SKIPPED = "manual.json", "next.json", "skipped.txt"

State = Literal["asked", "accepted", "recorded"]


@dataclass(frozen=True)
class PendingTest:
    """The test that the person is to run: the id of its row and its trace, and its state.

    An "accepted" test has a valid log in ``originals``, or a word for its failure, or for why it is void. A "recorded"
    one is in the table, with the seed of its rollout.
    """

    id: str
    params: dict[str, float]
    state: State = "asked"
    log: str | None = None
    failure: str | None = None
    void: str | None = None
    seed: int | None = None


@dataclass(frozen=True)
class TestFolder:
    """The folder of tests, which :meth:`prepare` makes. Each method raises a UsageError if a file cannot be written."""

    root: Path

    def prepare(
        self, channels: tuple[Channel, ...], parameters: tuple[Parameter, ...], seconds: float
    ) -> list[bytes]:
        """Prepare the folder for a run, and return a digest of each recorded trace within the horizon.

        Raises:
            UsageError: another process uses the folder, it has other parameters, or it cannot be written.
            LogError: the recordings are not valid.
        """
        try:
            for folder in (INCOMING, ORIGINALS, REFUSED):
                (self.root / folder).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"cannot make the folder {self.root}: {error.strerror or error}") from None
        held = f"another run uses the folder {self.root}; wait for it, or use another folder"
        lock(self.root, UsageError(held))
        columns, expected = table.read(self.root / TABLE)[0], table.header(parameters)
        if columns and columns != expected:
            raise UsageError(
                f"{self.root / TABLE} belongs to another specification: its columns are {', '.join(columns)}, and this "
                f"one needs {', '.join(expected)}; use another folder"
            )
        test = self.pending()
        if test is not None and test.state == "accepted" and test.id not in table.ids(self.root / TABLE):
            # A kill left the trace without a row; it is made again from the log.
            for ending in logs.FORMATS:
                (self.root / f"{test.id}{ending}").unlink(missing_ok=True)
        if (self.root / TABLE).exists():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", TraceNote)  # the log backend shows them later
                LogBackend(str(self.root))  # refuses a folder that is not valid
        record = {
            "schema": SCHEMA,
            "channels": [{"name": c.name, "unit": c.unit, "width": c.width} for c in channels],
            "parameters": [asdict(parameter) for parameter in parameters],
        }
        save(self.root / DECLARED, json.dumps(record, indent=2) + "\n")
        ids = table.ids(self.root / TABLE)
        paths = (self.root / f"{one}{ending}" for one in ids for ending in logs.FORMATS)
        traces = (logs.load(path, gather=True).trace for path in paths if path.exists())
        keys = (digest(within_horizon(trace, seconds)) for trace in traces)
        return [key for key in keys if key is not None]

    def declared(self) -> tuple[tuple[Channel, ...], tuple[Parameter, ...]]:
        """Return channels and parameters of the last prepared run, or none; a damaged file is a UsageError."""
        record = _json(self.root / DECLARED)
        if record is None:
            return (), ()
        try:
            rows, parameters = record["channels"], tuple(Parameter(**one) for one in record["parameters"])
            words = "as the spec reads it"
            return tuple(Channel(one["name"], one["unit"], words, one["width"]) for one in rows), parameters
        except (KeyError, TypeError):
            raise _damaged_error(self.root / DECLARED) from None

    def recorded(self) -> int:
        """Return the number of recorded rollouts."""
        return len(table.ids(self.root / TABLE))

    def pending(self) -> PendingTest | None:
        """Return the pending test; None if there is none. A damaged file is a UsageError."""
        record = _json(self.root / NEXT)
        if record is None:
            return None
        try:
            return PendingTest(**{name: record[name] for name in PendingTest.__dataclass_fields__})
        except (KeyError, TypeError):
            raise _damaged_error(self.root / NEXT) from None

    def write(self, test: PendingTest, about: Mapping[str, Any]) -> None:
        """Write the pending test, with further facts for the lab's scripts."""
        save(self.root / NEXT, json.dumps({"schema": SCHEMA, **asdict(test), **about}, indent=2) + "\n")

    def close(self) -> None:
        """Remove the pending test."""
        (self.root / NEXT).unlink(missing_ok=True)

    def new(self, params: Mapping[str, float]) -> PendingTest:
        """Return a new test with the next free id."""
        ids = table.ids(self.root / TABLE)
        ids += [path.name.partition("-")[0] for path in (self.root / ORIGINALS).iterdir()]
        last = max((int(one) for one in ids if one.isascii() and one.isdigit()), default=0)
        return PendingTest(f"{last + 1:04d}", dict(params))

    def waiting(self) -> list[Path]:
        """Return the logs in ``incoming``."""
        return sorted(
            path
            for path in (self.root / INCOMING).iterdir()
            if path.suffix.lower() in logs.READABLE and not path.name.startswith(".")
        )

    def taken(self, test: PendingTest) -> Path | None:
        """Return the log in ``originals`` of a test that a kill interrupted before it was accepted; else None."""
        return next(iter(sorted((self.root / ORIGINALS).glob(f"{test.id}-*"))), None)

    def take(self, path: Path, test: PendingTest) -> Path:
        """Move a log from ``incoming`` to ``originals``, or copy a log from elsewhere. Return its new path."""
        kept = self.root / ORIGINALS / f"{test.id}-{path.name}"
        linked = path.is_symlink()  # a move would keep the link, not the file
        _move(path, kept, move=path.parent == self.root / INCOMING and not linked)
        if linked and path.parent == self.root / INCOMING:
            path.unlink()
        return kept

    def refuse(self, path: Path) -> Path:
        """Move a refused log to ``refused``; a log from elsewhere stays. Return its path."""
        if path.parent not in (self.root / INCOMING, self.root / ORIGINALS):
            return path
        name = path.name.partition("-")[2] if path.parent == self.root / ORIGINALS else path.name
        kept, numbers = self.root / REFUSED / name, itertools.count(2)
        while kept.exists():
            kept = kept.with_name(f"{Path(name).stem}-{next(numbers)}{path.suffix}")
        _move(path, kept, move=True)
        return kept

    def record(
        self,
        test: PendingTest,
        trace: Trace,
        seed: int,
        channels: tuple[Channel, ...],
        parameters: tuple[Parameter, ...],
    ) -> Trace:
        """Write a trace and its row, and return the trace as read back.

        A channel that no format can hold stays only in the original; every format can hold the spec's channels.

        Raises:
            UsageError: a file cannot be written.
        """
        path = self.root / f"{test.id}{Path(test.log or 'none.csv').suffix.lower()}"
        try:
            logs.write(trace, path)
        except TraceError:
            path = path.with_suffix(".npz")
            try:
                logs.write(trace, path)
            except TraceError:
                logs.write(trace.only(channel.name for channel in channels), path)
        if test.id not in table.ids(self.root / TABLE):
            row = [test.id, *(repr(test.params[p.name]) for p in parameters), str(seed)]
            table.add(self.root / TABLE, table.header(parameters), row)
        return logs.load(path, gather=True).trace

    def trace(self, test: PendingTest) -> Trace:
        """Return the trace of a recorded test; a missing file is a UsageError."""
        for ending in logs.FORMATS:
            if (path := self.root / f"{test.id}{ending}").exists():
                return logs.load(path, gather=True).trace
        raise UsageError(f"the recording {test.id} is missing in {self.root}; restore it from a copy")

    def skip(self, test: PendingTest) -> None:
        """Record that a test did not begin because the robot was broken."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        row = [now, *(repr(value) for value in test.params.values())]
        table.add(self.root / SKIPPED, ["time", *test.params], row)

    def release(self) -> None:
        """Release the folder for another process."""
        release(self.root)


def placeholder(word: str, channels: tuple[Channel, ...]) -> Trace:
    """Return the trace of a failed rollout without a log: one sample, NaN in every channel."""
    samples = {c.name: np.full((1, c.width) if c.width > 1 else 1, np.nan) for c in channels}
    return Trace(np.zeros(1), samples, {c.name: c.unit for c in channels if c.unit}, {"failure": word})


def _move(path: Path, kept: Path, *, move: bool) -> None:
    try:
        if move:
            os.replace(path, kept)
            return
        with replacing(kept) as temporary:
            shutil.copyfile(path, temporary)
    except OSError as error:
        raise UsageError(f"cannot store {path} as {kept}: {error.strerror or error}") from None


def _json(path: Path) -> dict[str, Any] | None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError):
        raise _damaged_error(path) from None
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise _damaged_error(path)
    return record


def _damaged_error(path: Path) -> UsageError:
    return UsageError(f"{path} is damaged; move it away, and s2r requests the test again")
