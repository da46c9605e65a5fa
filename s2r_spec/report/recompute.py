"""A check again from its folder alone: the search is told the journal, nothing is run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.check import CheckResult, conclude, of_recordings, search_for
from s2r_spec.certify.search import Query, Search
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.journal import FILE, SPEC_FILE, Journal, Record
from s2r_spec.spec import Spec, load_spec


@dataclass(frozen=True)
class Recomputed:
    """A check with all that its pictures need.

    Attributes:
        spec: as the run keeps it.
        result: what the check found, or would have found had it ended with its last whole batch.
        search: that was told every whole batch.
        history: the certificate after each batch.
        records: all rollouts on disk.
        waiting: rollouts of a last batch that is not whole; they are on disk and not counted yet.
    """

    spec: Spec
    result: CheckResult
    search: Search
    history: tuple[Certificate, ...]
    records: tuple[Record, ...]
    waiting: int


def runs_in(folder: Path) -> list[Path]:
    """Return the folders of the single requirements' runs: this one, or those in it.

    Raises:
        UsageError: there is none.
    """
    if (folder / FILE).exists():
        return [folder]
    found = sorted(path.parent for path in folder.glob(f"*/{FILE}"))
    if not found:
        raise UsageError(f"no run in {folder}: there is no {FILE} in it, nor in a folder of it")
    return found


def recompute(folder: Path) -> Recomputed:
    """Compute the certificate of a finished or unfinished run again.

    Raises:
        UsageError: there is no rollout yet, it is a gap's run, the journal is damaged, or this version of s2r (or of
            the numerical libraries) does not ask for the recorded tests.
    """
    journal = Journal.read(folder)
    if "side" in journal.header:
        raise UsageError(f"{folder} is one side of a gap; s2r report draws runs of s2r check")
    if not len(journal):
        raise UsageError(f"{folder} has no rollouts yet, so there is nothing to report")
    spec, header = load_spec(folder / SPEC_FILE), journal.header
    search, history = _search(spec, journal)
    told = search.certificate().rollouts
    # With what it was told as its budget the search knows that it is over, and so refuses what a check
    # would have refused; of a run that goes on it says what it would have said had it ended here.
    search.budget = told
    records = journal.records()
    settings = spec.certify[header["requirement"]]
    assert settings.fall is not None  # search_for has looked
    result = conclude(
        spec,
        header["requirement"],
        settings.fall,
        search.certificate(),
        journal,
        header,
        sum(record.seconds for record in records),
    )
    if "recorded" in header:
        result = of_recordings(result, header["recorded"], search)
    return Recomputed(spec, result, search, tuple(history), tuple(records), len(records) - told)


def _search(spec: Spec, journal: Journal) -> tuple[Search, list[Certificate]]:
    """Tell a new search every whole batch of the journal; return it and its certificate after each."""
    header = journal.header
    search = search_for(
        spec,
        header["requirement"],
        seed=header["seed"],
        budget=None,
        mode=header["settings"]["mode"],
        engine=header["settings"]["engine"],
    )
    if search.certificate().settings != header["settings"]:
        raise UsageError(f"{journal.folder} was run by s2r {header['s2r']} with settings that this one lacks")
    if "recorded" in header:
        search.observe(_recorded(journal), final=True)
        return search, [search.certificate()]
    history: list[Certificate] = []
    while not search.done:
        queries = search.ask()
        outcomes = [_outcomes(query, journal) for query in queries]
        if any(len(values) < query.replicates for query, values in zip(queries, outcomes, strict=True)):
            break
        for query, values in zip(queries, outcomes, strict=True):
            search.tell(query, values)
        history.append(search.certificate())
    return search, history


def _recorded(journal: Journal) -> list[tuple[dict[str, float], list[float]]]:
    """Return (point, −ρ of its recordings) for every test of a fixed design."""
    groups: dict[int, tuple[dict[str, float], list[float]]] = {}
    for record in journal.records():
        groups.setdefault(record.query, (record.params, []))[1].append(-record.rho)
    return list(groups.values())


def _outcomes(query: Query, journal: Journal) -> list[float]:
    """Return −ρ of the rollouts that answer a query, as far as they are on disk."""
    found = [journal.get(query.index, replicate) for replicate in range(query.replicates)]
    records = [record for record in found if record is not None]
    for record in records:
        if record.params != query.point:
            raise UsageError(
                f"rollout {record.query}.{record.replicate} of {journal.folder} was run at {record.params}, now the "
                f"search asks for {query.point}: the numerical libraries are others than those of the run"
            )
    return [-record.rho for record in records]
