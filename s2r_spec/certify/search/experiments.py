"""Experiments: they answer the queries of a search with outcomes.

Every rollout is written to its journal first. Only then does the search get its outcome.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn, Protocol

import numpy as np

from s2r_spec.base.errors import BackendError, S2RError
from s2r_spec.certify.search.observers import Observer, OnlyCrashes
from s2r_spec.certify.search.search import Query, Search
from s2r_spec.machine.machine_runner import MachineRunner
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.machine_journal import Void
from s2r_spec.runs.repeatability import check_run, is_repeated
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.seeds import SeedStream, rollout_seed
from s2r_spec.runs.task import Done, Task

UNSCORED = "unscored"
"""Definition: word for a machine's rollout whose trace the requirement cannot evaluate."""


class OutcomeSource(Protocol):
    """Answers queries; every outcome is on disk before it is returned."""

    def outcomes(self, queries: Sequence[Query], observer: Observer) -> dict[int, list[float]]:
        """Return query index → (replicates,) outcomes."""

    def on_disk(self, index: int, replicates: int) -> bool:
        """Return whether the first outcomes of a query need no further rollout."""


@dataclass(frozen=True)
class Rollouts:
    """Rollouts on one backend. The outcome is −ρ, so its maximum is the worst case.

    Each outcome is the mean of ``each`` rollouts.
    """

    scorer: Scorer
    seed: int
    journal: Journal
    runner: Runner | MachineRunner
    stream: SeedStream = SeedStream.CHECK
    each: int = 1

    def outcomes(self, queries: Sequence[Query], observer: Observer) -> dict[int, list[float]]:
        """Run the rollouts that the journal lacks; see :class:`OutcomeSource`.

        Raises:
            BackendError: a rollout raised, or the journal belongs to a search with other tests.
            UsageError: a rollout of a simulator that is declared as deterministic cannot be repeated.
        """
        points = {query.index: query.point for query in queries}
        records: dict[tuple[int, int], Record] = {}
        tasks = {}
        for query in queries:
            for replicate in range(query.replicates * self.each):
                key = query.index, replicate
                task = self.scorer.task(*key, query.point, rollout_seed(self.seed, *key, self.stream))
                tasks[key] = task
                before = self._recorded(task, query.point)
                if before is not None:
                    records[key] = before
                    observer.rollout(before, new=False)
        for done in self.runner.run([task for key, task in tasks.items() if key not in records]):
            record = self._record(done, points[done.task.query])
            records[record.query, record.replicate] = record
            observer.rollout(record)
            if done.trace is None:
                observer.crash(record)
        if isinstance(self.runner, Runner) and is_repeated(self.scorer.backend):
            check_run(self.journal, self.runner, [(task, records[key]) for key, task in tasks.items()])
        return {
            query.index: [
                float(np.mean([-records[query.index, r * self.each + i].rho for i in range(self.each)]))
                for r in range(query.replicates)
            ]
            for query in queries
        }

    def on_disk(self, index: int, replicates: int) -> bool:
        """Return whether the journal has the rollouts of the first outcomes of a query."""
        return self.journal.has(index, replicates * self.each)

    def _recorded(self, task: Task, point: Mapping[str, float]) -> Record | None:
        before = self.journal.get(task.query, task.replicate)
        if before is not None and (before.params != point or before.seed != task.seed):
            raise BackendError(
                f"rollout {task.query}.{task.replicate} of {self.journal.folder} was run at {before.params}, but "
                f"the search now asks for {point}: the numerical libraries must have changed in between"
            )
        return before

    def _record(self, done: Done, point: dict[str, float]) -> Record:
        try:
            rho, failure = self.scorer.score(point, done)
        except S2RError as error:
            self._refuse(done, point, error)
        key = done.task.query, done.task.replicate
        record = Record(*key, point, done.task.seed, rho, failure, trace=None, seconds=round(done.seconds, 4))
        return self.journal.append(record, done.trace)

    def _refuse(self, done: Done, point: Mapping[str, float], error: S2RError) -> NoReturn:
        """Keep the trace of a rollout without ρ, and raise a BackendError that names it."""
        key = done.task.query, done.task.replicate
        kept = self.journal.keep(key, done.trace)
        for attempt in self.journal.open:  # a machine's rollout ends here, without an outcome
            if attempt.key == key:
                self.journal.void(Void(attempt, UNSCORED, str(error), None, done.seconds), done.trace)
        test = ", ".join(f"{name} = {value:.6g}" for name, value in point.items())
        raise BackendError(
            f"rollout {key[0]}.{key[1]} at {test} cannot be scored: {error}; its trace is kept in {kept}"
        ) from error


@dataclass(frozen=True)
class Pairs:
    """A simulated and a real rollout for each replicate. The outcome is −Δ = ρ_sim − ρ_real.

    The observer receives the rollouts of the ``watched`` backend, and only crashes of the other one.
    """

    simulated: OutcomeSource
    real: OutcomeSource
    watched: Literal["real", "simulated"] = "real"

    def outcomes(self, queries: Sequence[Query], observer: Observer) -> dict[int, list[float]]:
        """Run the real machine first: its rollouts are then on disk if the simulator raises."""
        others = OnlyCrashes(observer)
        real = self.real.outcomes(queries, observer if self.watched == "real" else others)
        simulated = self.simulated.outcomes(queries, others if self.watched == "real" else observer)
        return {index: [r - s for r, s in zip(real[index], simulated[index], strict=True)] for index in real}

    def on_disk(self, index: int, replicates: int) -> bool:
        """Return whether both journals have the rollouts of the first outcomes of a query."""
        return self.real.on_disk(index, replicates) and self.simulated.on_disk(index, replicates)


def next_queries(search: Search, on_disk: Callable[[int, int], bool]) -> list[Query]:
    """Return the queries to answer next; none once the search is over. For ``on_disk`` see :class:`OutcomeSource`.

    A run may have more rollouts on disk than its stopping rule or its budget now needs. The bound holds at every time,
    so the search takes them all, and its result is about the whole run. A search that is done leaves out an incomplete
    last batch: which of its rollouts are on disk may depend on their outcomes.
    """
    if not search.done:
        return search.ask()
    if not on_disk(search.answered, 1):
        return []
    queries = search.ask(beyond=True)
    if all(on_disk(query.index, query.replicates) for query in queries):
        return queries
    search.withdraw()
    return []


def run_search(search: Search, experiment: OutcomeSource, observer: Observer | None = None) -> None:
    """Run the search to its end, with every complete batch on disk; a BackendError if a rollout raised."""
    observer = observer or Observer()
    while queries := next_queries(search, experiment.on_disk):
        observer.batch(queries, search.certificate())
        outcomes = experiment.outcomes(queries, observer)
        for query in queries:
            search.tell(query, outcomes[query.index])
