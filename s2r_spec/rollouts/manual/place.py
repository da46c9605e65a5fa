"""The folder of tests that a person runs: what was asked, what was given, and what is recorded.

    rollouts.csv  0001.csv  0002.npz …   what was recorded, as ``log:FOLDER`` reads it
    incoming/      where the person puts a log
    originals/     each log as it was given, <id>-<name>
    refused/       logs that were not of the test, as they were given
    manual.json    channels and parameters that the specification asks for
    next.json      the test that is asked for now, and how far it is
    skipped.txt    tests that were not begun because the robot was broken

Every file is replaced whole or not at all. A trace is written before its row; a kill in between leaves a trace
without a row, which the next start completes.
"""

from __future__ import annotations

import json
import os
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from s2r_spec import logs
from s2r_spec.backend import Channel, Parameter
from s2r_spec.errors import TraceError, TraceNote, UsageError
from s2r_spec.files import replacing, save
from s2r_spec.rollouts.manual import table
from s2r_spec.rollouts.manual.checks import what_counts
from s2r_spec.rollouts.recorded import TABLE, LogBackend, digest
from s2r_spec.trace import Trace

SCHEMA = "s2r.manual/1"
INCOMING, ORIGINALS, REFUSED = "incoming", "originals", "refused"
DECLARED, NEXT, SKIPPED, LOCK = "manual.json", "next.json", "skipped.txt", "lock"

State = Literal["asked", "accepted", "recorded"]
_held: dict[Path, int] = {}
"""Folders that this process holds, by their locks; the system lets go of them when it ends."""


@dataclass(frozen=True)
class Step:
    """The test that is asked for, and how far it is.

    Attributes:
        id: of its row and its trace.
        params: of the test.
        state: "asked"; "accepted", there is a log that fits or a word for how it failed; "recorded", in the table.
        log: name of the log in ``originals``; None if there is none.
        failure: word for how it failed, as the person says; None for nothing.
        void: word for why it is no outcome; None if it is one.
        seed: of the rollout that it was recorded for; None before that.
    """

    id: str
    params: dict[str, float]
    state: State = "asked"
    log: str | None = None
    failure: str | None = None
    void: str | None = None
    seed: int | None = None


@dataclass(frozen=True)
class Place:
    """A folder, and what is done in it; nothing is made before :meth:`prepare`."""

    root: Path

    def prepare(
        self, channels: tuple[Channel, ...], parameters: tuple[Parameter, ...], seconds: float
    ) -> list[bytes]:
        """Make the folder ready for a run, and return the digests of all traces in it, each of what counts of it.

        Raises:
            UsageError: another process uses it, its rollouts are of other parameters, or it cannot be written.
            LogError: it is no valid folder of recordings.
        """
        try:
            for folder in (INCOMING, ORIGINALS, REFUSED):
                (self.root / folder).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"cannot make the folder {self.root}: {error.strerror or error}") from None
        self._hold()
        there, wanted = table.read(self.root / TABLE)[0], table.header(parameters)
        if there and there != wanted:
            raise UsageError(
                f"{self.root / TABLE} is of other tests: its columns are {', '.join(there)}, and the spec's are "
                f"{', '.join(wanted)}; use another folder"
            )
        if (step := self.step()) is not None:
            self._complete(step)
        if (self.root / TABLE).exists():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", TraceNote)  # it says them where it is used
                LogBackend(str(self.root))  # refuses what is no folder of recordings
        record = {
            "schema": SCHEMA,
            "channels": [{"name": c.name, "unit": c.unit, "width": c.width} for c in channels],
            "parameters": [asdict(parameter) for parameter in parameters],
        }
        save(self.root / DECLARED, json.dumps(record, indent=2) + "\n")
        traces = (what_counts(logs.load(path, gather=True).trace, seconds) for path in self._traces())
        return [found for trace in traces if (found := digest(trace)) is not None]

    def declared(self) -> tuple[tuple[Channel, ...], tuple[Parameter, ...]]:
        """Return the channels and parameters of the run that was prepared last; none where none was.

        Raises:
            UsageError: the file that says so is damaged.
        """
        record = _json(self.root / DECLARED)
        if record is None:
            return (), ()
        try:
            return (
                tuple(
                    Channel(one["name"], one["unit"], "as the spec reads it", one["width"])
                    for one in record["channels"]
                ),
                tuple(Parameter(**one) for one in record["parameters"]),
            )
        except (KeyError, TypeError):
            raise _damaged(self.root / DECLARED) from None

    def recorded(self) -> int:
        """Return how many rollouts are recorded."""
        return len(table.ids(self.root / TABLE))

    def step(self) -> Step | None:
        """Return the test that is asked for; None if there is none.

        Raises:
            UsageError: the file that says so is damaged.
        """
        record = _json(self.root / NEXT)
        if record is None:
            return None
        try:
            return Step(**{name: record[name] for name in Step.__dataclass_fields__})
        except (KeyError, TypeError):
            raise _damaged(self.root / NEXT) from None

    def write(self, step: Step, about: Mapping[str, Any]) -> Step:
        """Write how far a test is, with what a script of the lab may want to know about it."""
        save(self.root / NEXT, json.dumps({"schema": SCHEMA, **asdict(step), **about}, indent=2) + "\n")
        return step

    def close(self) -> None:
        """Ask for nothing."""
        (self.root / NEXT).unlink(missing_ok=True)

    def new(self, params: Mapping[str, float]) -> Step:
        """Return a step for a test, with the next free id."""
        ids = table.ids(self.root / TABLE)
        ids += [path.name.partition("-")[0] for path in (self.root / ORIGINALS).iterdir()]
        last = max((int(one) for one in ids if one.isascii() and one.isdigit()), default=0)
        return Step(f"{last + 1:04d}", dict(params))

    def waiting(self) -> list[Path]:
        """Return the traces that lie in the folder where the person puts them."""
        return sorted(
            path
            for path in (self.root / INCOMING).iterdir()
            if path.suffix.lower() in logs.FORMATS and not path.name.startswith(".")
        )

    def given(self, step: Step) -> Path | None:
        """Return a log that was taken for a step whose acceptance was cut off by a kill; None if there is none."""
        return next(iter(sorted((self.root / ORIGINALS).glob(f"{step.id}-*"))), None)

    def take(self, path: Path, step: Step) -> Path:
        """Move a log from ``incoming`` to the originals; of one that lies elsewhere keep a copy. Return where.

        Raises:
            UsageError: it cannot be moved there.
        """
        kept = self.root / ORIGINALS / f"{step.id}-{path.name}"
        linked = path.is_symlink()  # a link that was moved would still be only a link
        _moved(path, kept, move=path.parent == self.root / INCOMING and not linked)
        if linked and path.parent == self.root / INCOMING:
            path.unlink()
        return kept

    def refuse(self, path: Path) -> Path:
        """Move a log that is not of the test out of the way; one that lies elsewhere stays. Return where it is.

        Raises:
            UsageError: it cannot be moved.
        """
        if path.parent not in (self.root / INCOMING, self.root / ORIGINALS):
            return path
        name = path.name.partition("-")[2] if path.parent == self.root / ORIGINALS else path.name
        kept = self.root / REFUSED / name
        number = 1
        while kept.exists():
            number += 1
            kept = kept.with_name(f"{Path(name).stem}-{number}{path.suffix}")
        _moved(path, kept, move=True)
        return kept

    def record(
        self,
        step: Step,
        trace: Trace,
        seed: int,
        channels: tuple[Channel, ...],
        parameters: tuple[Parameter, ...],
    ) -> Trace:
        """Write a trace and its row, and return the trace as it is read back.

        A channel that no format can hold is left to the original; those of the spec have names that each can.

        Raises:
            UsageError: it cannot be written.
        """
        path = self.root / f"{step.id}{Path(step.log or 'none.csv').suffix.lower()}"
        try:
            logs.write(trace, path)
        except TraceError:
            path = path.with_suffix(".npz")
            try:
                logs.write(trace, path)
            except TraceError:
                logs.write(trace.only(channel.name for channel in channels), path)
        if step.id not in table.ids(self.root / TABLE):
            row = [step.id, *(repr(step.params[p.name]) for p in parameters), str(seed)]
            table.add(self.root / TABLE, table.header(parameters), row)
        return logs.load(path, gather=True).trace

    def trace(self, step: Step) -> Trace:
        """Return the trace of a step that is recorded.

        Raises:
            UsageError: it is gone.
        """
        for ending in logs.FORMATS:
            if (path := self.root / f"{step.id}{ending}").exists():
                return logs.load(path, gather=True).trace
        raise UsageError(f"the recording {step.id} is no longer in {self.root}; restore it from a copy")

    def skip(self, step: Step) -> None:
        """Note that a test was not begun because the robot was broken."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        row = [now, *(repr(value) for value in step.params.values())]
        table.add(self.root / SKIPPED, ["time", *step.params], row)

    def release(self) -> None:
        """Let another process use the folder."""
        handle = _held.pop(self.root.resolve(), None)
        if handle is not None:
            os.close(handle)

    def _complete(self, step: Step) -> None:
        """Take away a trace whose row a kill prevented: it is made again from the log that was given."""
        if step.state == "accepted" and step.id not in table.ids(self.root / TABLE):
            for ending in logs.FORMATS:
                (self.root / f"{step.id}{ending}").unlink(missing_ok=True)

    def _traces(self) -> list[Path]:
        """Return the traces that are recorded, in order."""
        ids = table.ids(self.root / TABLE)
        paths = (self.root / f"{one}{ending}" for one in ids for ending in logs.FORMATS)
        return [path for path in paths if path.exists()]

    def _hold(self) -> None:
        """Hold the folder for this process: two runs would take each other's logs.

        Raises:
            UsageError: another process holds it.
        """
        try:
            import fcntl
        except ImportError:  # not a POSIX system: nothing to hold it with
            return
        if self.root.resolve() in _held:
            return
        handle = os.open(self.root / LOCK, os.O_CREAT | os.O_RDWR, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            raise UsageError(
                f"another run asks for tests in {self.root}: wait for it, or use another folder"
            ) from None
        _held[self.root.resolve()] = handle


def without_log(word: str, channels: tuple[Channel, ...]) -> Trace:
    """Return what stands for a rollout that failed and has no log: one sample of nothing."""
    samples = {c.name: np.full((1, c.width) if c.width > 1 else 1, np.nan) for c in channels}
    return Trace(np.zeros(1), samples, {c.name: c.unit for c in channels if c.unit}, {"failure": word})


def recorded(step: Step, seed: int) -> Step:
    """Return a step that is in the table."""
    return replace(step, state="recorded", seed=seed)


def _moved(path: Path, kept: Path, *, move: bool) -> None:
    """Move a file, or keep a copy of it; whole or not at all.

    Raises:
        UsageError: it cannot be done.
    """
    try:
        if move:
            os.replace(path, kept)
            return
        with replacing(kept) as beside:
            shutil.copyfile(path, beside)
    except OSError as error:
        raise UsageError(f"cannot keep {path} as {kept}: {error.strerror or error}") from None


def _json(path: Path) -> dict[str, Any] | None:
    """Return the object in a file of this package; None if there is no file.

    Raises:
        UsageError: it is damaged, or another program's.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError):
        raise _damaged(path) from None
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise _damaged(path)
    return record


def _damaged(path: Path) -> UsageError:
    return UsageError(f"{path} is damaged; move it away, and the test is asked again")
