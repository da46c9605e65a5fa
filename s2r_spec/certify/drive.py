"""Between a search and its rollouts: what is asked for is run, recorded, and only then told."""

from __future__ import annotations

from typing import Protocol

from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.search import Query, Search
from s2r_spec.errors import BackendError
from s2r_spec.rollouts.journal import Journal, Record
from s2r_spec.rollouts.rig import Rig
from s2r_spec.rollouts.runner import Runner
from s2r_spec.rollouts.seeds import rollout_seed


class Observer(Protocol):
    """Is told how a check goes."""

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        """Say that a batch begins; the certificate is of what came before it."""
        ...

    def rollout(self, record: Record) -> None:
        """Say that one rollout is on disk."""
        ...


class Silent:
    """An observer that says nothing."""

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        """Do nothing."""

    def rollout(self, record: Record) -> None:
        """Do nothing."""


def drive(
    search: Search, rig: Rig, seed: int, journal: Journal, runner: Runner, observer: Observer | None = None
) -> None:
    """Run the search to its end on −ρ, so that its maximum is the worst expected ρ.

    Raises:
        BackendError: a rollout raised, or the journal is of a search that asked for other tests.
    """
    observer = observer or Silent()
    while not search.done:
        queries = search.ask()
        observer.batch(queries, search.certificate())
        records = _run(queries, rig, seed, journal, runner, observer)
        for query in queries:
            search.tell(query, [-record.rho for record in records[query.index]])


def _run(
    queries: list[Query], rig: Rig, seed: int, journal: Journal, runner: Runner, observer: Observer
) -> dict[int, list[Record]]:
    """Return query → records by replicate; each is on disk, and those of an earlier session are not run again."""
    points = {query.index: query.point for query in queries}
    records: dict[tuple[int, int], Record] = {}
    tasks = []
    for query in queries:
        for replicate in range(query.replicates):
            task = rig.task(query.index, replicate, query.point, rollout_seed(seed, query.index, replicate))
            before = journal.get(query.index, replicate)
            if before is None:
                tasks.append(task)
            elif before.params != query.point or before.seed != task.seed:
                raise BackendError(
                    f"rollout {query.index}.{replicate} of {journal.folder} was run at {before.params}, now the "
                    f"search asks for {query.point}: the numerical libraries must have changed in between"
                )
            else:
                records[query.index, replicate] = before
                observer.rollout(before)
    for done in runner.run(tasks):
        point = points[done.task.query]
        rho, failure = rig.score(point, done)
        key = done.task.query, done.task.replicate
        record = Record(*key, point, done.task.seed, rho, failure, trace=None, seconds=round(done.seconds, 4))
        records[key] = journal.append(record, done.trace)
        observer.rollout(records[key])
    return {query.index: [records[query.index, r] for r in range(query.replicates)] for query in queries}
