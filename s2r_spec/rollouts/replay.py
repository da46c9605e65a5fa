"""Run one recorded rollout again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from s2r_spec.errors import UsageError
from s2r_spec.rollouts.journal import SPEC_FILE, Journal
from s2r_spec.rollouts.match import match
from s2r_spec.rollouts.outcome import score
from s2r_spec.rollouts.runner import Done, Task, open_backend, run_task
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Replay:
    """A rollout run again, beside what the journal says of it."""

    params: dict[str, float]
    seed: int
    rho: float
    recorded: float
    unit: str
    trace: Trace
    difference: str
    """Why ρ may differ from the record; "" when it does not."""

    @property
    def same(self) -> bool:
        """Whether ρ is the recorded one, bit for bit."""
        return self.rho == self.recorded


def replay(rollout: str) -> Replay:
    """Run ``FOLDER#QUERY.REPLICATE`` again.

    Raises:
        UsageError: the text is not of that form, or the run has no such rollout.
    """
    folder, hash_sign, key = rollout.rpartition("#")
    query, dot, replicate = key.partition(".")
    if not (hash_sign and dot and query.isdecimal() and replicate.isdecimal()):
        raise UsageError(
            f"{rollout!r} is not FOLDER#QUERY.REPLICATE, for example s2r-runs/night/walking#12.3"
        )
    journal = Journal.read(Path(folder))
    record = journal.get(int(query), int(replicate))
    if record is None:
        raise UsageError(f"{folder} has no rollout {key}; it has {len(journal)} rollouts")
    header = journal.header
    spec = load_spec(journal.folder / SPEC_FILE)
    requirement = header["requirement"]
    machine = open_backend(header["backend"], header["duration"])
    point = dict(record.params)
    params = match(spec, requirement, machine).to_backend(point)
    task = Task(record.query, record.replicate, header["backend"], params, record.seed, header["duration"])
    trace, seconds = run_task(task)
    fall = spec.certify[requirement].fall
    assert fall is not None
    rho, _ = score(spec, requirement, point, Done(task, trace, seconds), fall)
    difference = ""
    if rho != record.rho:
        difference = f"the record says {record.rho:+.6f}"
        if machine.model_hash != header["model_hash"]:
            difference += (
                f"; the model has changed since ({header['model_hash'][:12]}, now {machine.model_hash[:12]})"
            )
    return Replay(point, record.seed, rho, record.rho, spec.unit(requirement), trace, difference)
