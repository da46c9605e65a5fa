"""Run one recorded rollout again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from s2r_spec.backend import Backend, HasPictures, short
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.journal import SPEC_FILE, Journal
from s2r_spec.rollouts.rig import Rig
from s2r_spec.rollouts.runner import Done, run_task
from s2r_spec.spec import Spec, load_spec
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
    spec: Spec
    requirement: str
    backend: Backend
    backend_params: dict[str, float]
    """The test as the backend takes it: its own names and units."""
    difference: str
    """Why ρ may differ from the record; "" when it does not."""

    @property
    def same(self) -> bool:
        """Whether ρ is the recorded one, bit for bit."""
        return self.rho == self.recorded

    def render(self, path: Path) -> None:
        """Let the backend draw the rollout.

        Raises:
            UsageError: it has no pictures, or cannot draw them on this machine.
        """
        if not isinstance(self.backend, HasPictures):
            raise UsageError(f"the backend {self.backend.name!r} draws no pictures; --plot needs none")
        self.backend.render(self.backend_params, self.seed, path)


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
    header, point = journal.header, dict(record.params)
    spec = load_spec(journal.folder / SPEC_FILE)
    requirement = header["requirement"]
    rig = Rig.for_spec(spec, requirement, header["backend"], header["duration"])
    # All channels this time: whoever replays a rollout wants to look at it.
    task = replace(rig.task(record.query, record.replicate, point, record.seed), channels=None)
    trace, seconds = run_task(task)
    rho, _ = rig.score(point, Done(task, trace, seconds))
    difference = ""
    if rho != record.rho:
        difference = f"the record says {record.rho:+.6f}"
        if rig.backend.model_hash != header["model_hash"]:
            before, now = short(header["model_hash"]), short(rig.backend.model_hash)
            difference += f"; the model has changed since ({before}, now {now})"
    return Replay(
        point,
        record.seed,
        rho,
        record.rho,
        spec.unit(requirement),
        trace,
        spec,
        requirement,
        rig.backend,
        dict(task.params),
        difference,
    )
