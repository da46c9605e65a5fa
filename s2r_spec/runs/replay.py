"""Run one recorded rollout again; for a machine, return its recorded trace."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from s2r_spec import logs
from s2r_spec.backend import Backend, HasPictures, is_exclusive, short
from s2r_spec.base.errors import UnknownBackendError, UsageError
from s2r_spec.base.files import saving
from s2r_spec.base.printable import one_line
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.spec_files import checked_header, load_run_spec
from s2r_spec.runs.task import Done, run_task
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace


@dataclass(frozen=True, repr=False)
class Replay:
    """A simulated rollout that ran again, or a machine's recorded rollout, with its record in the journal."""

    params: dict[str, float]
    seed: int
    rho: float
    recorded: float
    unit: str
    trace: Trace
    spec: Spec
    requirement: str
    backend: Backend
    backend_params: dict[str, float]
    """The test in the backend's names and units."""
    difference: str
    """Why ρ may differ from the record; "" if it does not differ."""
    ran: bool = True
    """False for a machine, to which nothing was sent."""

    @property
    def same(self) -> bool:
        """Whether ρ equals the recorded one, bit for bit."""
        return self.rho == self.recorded

    def __repr__(self) -> str:
        test = ", ".join(f"{name} = {value:.6g}" for name, value in self.params.items())
        same = "as recorded" if self.same else self.difference
        rho = f"ρ = {self.rho:+.6g} {self.unit}".rstrip()
        return one_line(f"Replay({test}, seed {self.seed}: {rho}, {same})")

    def render(self, path: Path) -> None:
        """Have the backend draw the rollout.

        Raises:
            UsageError: the backend draws no pictures, or cannot do so on this computer.
        """
        if not self.ran:
            raise UsageError(
                f"{self.backend.name} is a machine, and rendering would move it; --plot draws the recorded trace"
            )
        if not isinstance(self.backend, HasPictures):
            raise UsageError(
                f"the backend {self.backend.name!r} cannot render a rollout; use --plot, which works for every backend"
            )
        with saving(path) as temporary:
            try:
                self.backend.render(self.backend_params, self.seed, temporary)
            except UsageError as error:
                raise UsageError(str(error).replace(temporary.name, path.name)) from None


def replay(rollout: str, backend: Backend | None = None) -> Replay:
    """Run the rollout ``FOLDER#QUERY.REPLICATE`` again, or read its trace if a machine ran it.

    Args:
        rollout: folder of the run, and number of the rollout, as results print it.
        backend: the backend object, if the run had one; None to open it by its name.

    Raises:
        UsageError: the text has another form, the run has no such rollout, or its files were changed.
    """
    match = re.fullmatch(r"(?s)(?P<folder>.*)#(?P<query>[0-9]{1,20})\.(?P<replicate>[0-9]{1,20})", rollout)
    if match is None:
        raise UsageError(f"{rollout!r} is not FOLDER#QUERY.REPLICATE, such as s2r-runs/night/walking#12.3")
    journal = Journal.read(Path(match["folder"]))
    record = journal.get(int(match["query"]), int(match["replicate"]))
    if record is None:
        key = rollout.rpartition("#")[2]
        raise UsageError(f"{journal.folder} has no rollout {key}; it has {len(journal)} rollouts")
    spec = load_run_spec(journal)
    header, point = checked_header(journal), dict(record.params)
    requirement = header["requirement"]
    scorer = _scorer(spec, header, journal, backend)
    # All channels, because a replay is for looking at the rollout.
    task = replace(scorer.task(record.query, record.replicate, point, record.seed), channels=None)
    ran = not is_exclusive(scorer.backend)
    trace = run_task(task)[0] if ran else _recorded_trace(journal, record)
    rho, _ = scorer.score(point, Done(task, trace, record.seconds, None if ran else record.failure))
    difference = ""
    if rho != record.rho:
        difference = f"the record says {record.rho:+.6g}"
        # Each journal of a gap has both systems in its header.
        recorded = header[header["side"]]["model_hash"] if "side" in header else header["model_hash"]
        if scorer.backend.model_hash != recorded:
            before, now = short(recorded), short(scorer.backend.model_hash)
            difference += f"; the model has changed since ({before}, now {now})"
    unit, params = spec.unit(requirement), dict(task.params)
    compared = point, record.seed, rho, record.rho, unit
    return Replay(*compared, trace, spec, requirement, scorer.backend, params, difference, ran)


def _recorded_trace(journal: Journal, record: Record) -> Trace:
    if record.trace is None:
        raise UsageError(f"{journal.place(record)}: this rollout left no trace ({record.failure})")
    journal.check_traces()
    path = journal.folder / record.trace
    if not path.is_file():
        raise UsageError(
            f"{path} is missing, and a machine's rollout cannot run again; restore the file from a copy"
        )
    return logs.read(path)


def _scorer(spec: Spec, header: Mapping[str, Any], journal: Journal, passed: Backend | None) -> Scorer:
    requirement, name, duration = header["requirement"], header["backend"], header["duration"]
    backend = name if passed is None else passed
    try:
        own = Scorer.for_spec(spec, requirement, backend)
    except UnknownBackendError:
        raise UsageError(
            f"the backend {name!r} of {journal.folder} is not installed; if the run had an object, repeat its rollout "
            f"from Python: s2r.replay(rollout, backend)"
        ) from None
    if duration > own.backend.duration:
        raise UsageError(
            f"{journal.path}:1: duration is {duration:g} s, but rollouts of {name} now last "
            f"{own.backend.duration:g} s; install the version of s2r that began the run"
        )
    return own if duration == own.backend.duration else Scorer.for_spec(spec, requirement, backend, duration)
