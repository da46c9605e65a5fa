"""Between a search and its rollouts: what is asked for is run, recorded, and only then told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.search import Query, Search
from s2r_spec.errors import BackendError, S2RError
from s2r_spec.rollouts.journal import Journal, Record
from s2r_spec.rollouts.machine_journal import Void
from s2r_spec.rollouts.runner import Done, Task
from s2r_spec.rollouts.scorer import Scorer
from s2r_spec.rollouts.seeds import Stream, rollout_seed

UNSCORED = "unscored"
"""Definition: word of a machine's rollout whose trace the requirement cannot judge."""


@dataclass(frozen=True)
class Phase:
    """What a search is after.

    Attributes:
        symbol: of what is bounded, "ρ" or "Δ".
        unit: of it.
        backend: whose rollouts are counted.
        units: of the test parameters.
        budget: most rollouts, if there is one.
        attended: the backend is a machine, whose operator is asked at the terminal meanwhile.
    """

    symbol: str
    unit: str
    backend: str
    units: Mapping[str, str]
    budget: int | None
    attended: bool = False


class Observer(Protocol):
    """Is told how a search goes."""

    def begin(self, phase: Phase) -> None:
        """Say that a search begins."""
        ...

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        """Say that a batch begins; the certificate is of what came before it."""
        ...

    def rollout(self, record: Record, new: bool = True) -> None:
        """Say that one rollout is on disk; a resumed run tells again those that are not new."""
        ...

    def crash(self, record: Record) -> None:
        """Say that a rollout left no trace: its worker died, or hung and was ended."""
        ...


class Silent:
    """An observer that says nothing."""

    def begin(self, phase: Phase) -> None:
        """Do nothing."""

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        """Do nothing."""

    def rollout(self, record: Record, new: bool = True) -> None:
        """Do nothing."""

    def crash(self, record: Record) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class OnlyCrashes(Silent):
    """Passes crashes on, and nothing else."""

    observer: Observer

    def crash(self, record: Record) -> None:
        """Pass it on."""
        self.observer.crash(record)


class Runs(Protocol):
    """Runs tasks: a :class:`s2r_spec.rollouts.runner.Runner`, or what attends to a machine."""

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Yield every task's outcome; see there."""
        ...


class Experiment(Protocol):
    """Answers queries with outcomes, all of which are on disk by then."""

    def outcomes(self, queries: Sequence[Query], observer: Observer) -> dict[int, list[float]]:
        """Return query index → (replicates,) outcomes."""
        ...


@dataclass(frozen=True)
class Rollouts:
    """Rollouts on one scorer; the outcome is −ρ, so that a maximum is the worst case.

    Attributes:
        scorer: what turns a test into ρ.
        seed: of the run.
        journal: where every rollout goes first.
        runner: of the rollouts.
        stream: of seeds.
        each: rollouts per replicate; the outcome is their mean.
    """

    scorer: Scorer
    seed: int
    journal: Journal
    runner: Runs
    stream: Stream = Stream.CHECK
    each: int = field(default=1)

    def outcomes(self, queries: Sequence[Query], observer: Observer) -> dict[int, list[float]]:
        """Run what the journal does not hold yet; see :class:`Experiment`.

        Raises:
            BackendError: a rollout raised, or the journal is of a search that asked for other tests.
        """
        points = {query.index: query.point for query in queries}
        records: dict[tuple[int, int], Record] = {}
        tasks = []
        for query in queries:
            for replicate in range(query.replicates * self.each):
                key = query.index, replicate
                task = self.scorer.task(*key, query.point, rollout_seed(self.seed, *key, self.stream))
                before = self.journal.get(*key)
                if before is None:
                    tasks.append(task)
                elif before.params != query.point or before.seed != task.seed:
                    raise BackendError(
                        f"rollout {query.index}.{replicate} of {self.journal.folder} was run at {before.params}, now "
                        f"the search asks for {query.point}: the numerical libraries must have changed in between"
                    )
                else:
                    records[key] = before
                    observer.rollout(before, new=False)
        for done in self.runner.run(tasks):
            key, point = (done.task.query, done.task.replicate), points[done.task.query]
            try:
                rho, failure = self.scorer.score(point, done)
            except S2RError as error:
                kept = self.journal.keep(key, done.trace)
                for begun in self.journal.open:  # of a machine, whose rollout has an end, if no outcome
                    if begun.key == key:
                        self.journal.void(Void(begun, UNSCORED, str(error), None, done.seconds), done.trace)
                test = ", ".join(f"{name} = {value:.6g}" for name, value in point.items())
                raise BackendError(
                    f"rollout {key[0]}.{key[1]} at {test} cannot be scored: {error}; its trace is kept in {kept}"
                ) from error
            record = Record(
                *key, point, done.task.seed, rho, failure, trace=None, seconds=round(done.seconds, 4)
            )
            records[key] = self.journal.append(record, done.trace)
            observer.rollout(records[key])
            if done.trace is None:
                observer.crash(records[key])
        return {
            query.index: [
                float(np.mean([-records[query.index, r * self.each + i].rho for i in range(self.each)]))
                for r in range(query.replicates)
            ]
            for query in queries
        }


@dataclass(frozen=True)
class Pairs:
    """A simulated and a real rollout for each replicate; the outcome is −Δ = ρ_sim − ρ_real.

    The observer is told of the rollouts of the side that is ``watched``.
    """

    simulated: Experiment
    real: Experiment
    watched: Literal["real", "simulated"] = "real"

    def outcomes(self, queries: Sequence[Query], observer: Observer) -> dict[int, list[float]]:
        """Run both sides, the real one first: what it costs must be recorded whatever the simulator does."""
        watched = {self.watched: observer}
        others = OnlyCrashes(observer)
        real = self.real.outcomes(queries, watched.get("real", others))
        simulated = self.simulated.outcomes(queries, watched.get("simulated", others))
        return {index: [r - s for r, s in zip(real[index], simulated[index], strict=True)] for index in real}


def run_search(search: Search, experiment: Experiment, observer: Observer | None = None) -> None:
    """Run the search to its end.

    Raises:
        BackendError: a rollout raised; all that came before is on disk.
    """
    observer = observer or Silent()
    while not search.done:
        queries = search.ask()
        observer.batch(queries, search.certificate())
        outcomes = experiment.outcomes(queries, observer)
        for query in queries:
            search.tell(query, outcomes[query.index])
