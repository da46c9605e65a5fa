"""Recompute a result from its folder: the searches get the journals' outcomes, and nothing is simulated.

The result is that of the run, bit for bit, if the version of s2r and of the numerical libraries is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from s2r_spec.base.errors import UsageError
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.from_spec import search_for
from s2r_spec.certify.gap import gap_search
from s2r_spec.certify.options import RunOptions
from s2r_spec.certify.real_machine import CertifyResult, conclude_certify, refused_in_simulation
from s2r_spec.certify.result.check_result import CheckResult, conclude
from s2r_spec.certify.result.compose import decides
from s2r_spec.certify.result.gap_result import GapResult, Pair, conclude_gap, pairs_of
from s2r_spec.certify.search.experiments import next_queries
from s2r_spec.certify.search.search import Query, Search
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.layout import FILE, GAP, SIMULATION, SYSTEMS, runs_in
from s2r_spec.runs.repeatability import refuse_unrepeatable
from s2r_spec.runs.spec_files import PILOT, load_run_spec
from s2r_spec.runs.stop_rule import DECIDED, repeats_of, stop_of
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class Recomputed:
    """A check with the data of its figures.

    Attributes:
        spec: the specification that the run kept.
        result: the result of the check after its last complete batch.
        history: the certificate after each batch.
        waiting: number of rollouts on disk in an incomplete last batch; the result does not count them.
    """

    spec: Spec
    result: CheckResult
    search: Search
    history: tuple[Certificate, ...]
    records: tuple[Record, ...]
    waiting: int


@dataclass(frozen=True)
class RecomputedGap:
    """A gap with the data of its figures; see :class:`Recomputed`.

    ``pairs`` holds the pairs of the complete batches.
    """

    spec: Spec
    result: GapResult
    search: Search
    history: tuple[Certificate, ...]
    pairs: tuple[Pair, ...]
    simulated: tuple[Record, ...]
    real: tuple[Record, ...]
    waiting: int


@dataclass(frozen=True)
class RecomputedCertify:
    """A certificate of both steps with the data of its figures; no gap if the simulation's was refused."""

    spec: Spec
    result: CertifyResult
    simulated: Recomputed
    gap: RecomputedGap | None


Certified = CheckResult | GapResult | CertifyResult
Run = Recomputed | RecomputedGap | RecomputedCertify
Outcomes = Mapping[tuple[int, int], tuple[Mapping[str, float], float]]
"""(number of the test, number of the rollout) → the test, and the outcome that the search maximises."""


class RunKind(Enum):
    """The kind of a run's folder; the value is the command that made it."""

    CHECK = "s2r check"
    GAP = "s2r gap"
    CERTIFY = "s2r certify"


def kind(folder: Path) -> RunKind:
    """Return which command made a run.

    Raises:
        UsageError: the folder holds no run.
    """
    # A check of requirements with these names has the same folders.
    if all(Journal.header_in(folder / side).get("side") == side for side in SYSTEMS):
        return RunKind.GAP
    if (folder / SIMULATION / FILE).exists() and (folder / GAP / SYSTEMS[1] / FILE).exists():
        return RunKind.CERTIFY
    runs_in(folder)
    return RunKind.CHECK


def recompute_all(folder: Path) -> Sequence[Run]:
    """Return the result of every requirement of a run; see :func:`recompute`."""
    match kind(folder):
        case RunKind.GAP:
            return [recompute_gap(folder)]
        case RunKind.CERTIFY:
            return [recompute_certify(folder)]
        case RunKind.CHECK:
            return [recompute(one) for one in runs_in(folder)]


def recompute_again(result: Certified) -> Run:
    """Return a result from its folder, for a page; see :func:`recompute`."""
    if isinstance(result, CheckResult):
        return recompute(result.folder)
    if isinstance(result, GapResult):
        return recompute_gap(result.folder)
    return recompute_certify(result.simulated.folder.parent, result.real)


def recompute(folder: Path) -> Recomputed:
    """Return the result of a finished or unfinished check.

    Raises:
        UsageError: there is no rollout yet, the run belongs to a gap, the journal is damaged, or this version of s2r
            (or of the numerical libraries) chooses tests that differ from the recorded ones.
    """
    journal = Journal.read(folder)
    _refuse_pilot(folder, journal)
    if "side" in journal.header:
        raise UsageError(f"{folder} is one half of a gap's run; give its parent folder")
    if not len(journal):
        raise UsageError(f"{folder} has no rollouts yet, so there is nothing to report")
    refuse_unrepeatable(folder)
    spec, header = load_run_spec(journal), journal.header
    requirement, records = header["requirement"], journal.records()
    journal.check_traces()
    search = search_for(spec, requirement, _options(header))
    _same_settings(search, header, folder)
    outcomes = {(one.query, one.replicate): (one.params, -one.rho) for one in records}
    history = _replay(search, header, outcomes, folder)
    counted = search.certificate().rollouts
    # A closed search is finished, and refuses a certificate exactly if the check would have refused it
    # at this point.
    search.close()
    result = conclude(spec, search, journal, header)
    return Recomputed(spec, result, search, history, tuple(records), len(records) - counted)


def recompute_gap(folder: Path, simulated: Search | None = None) -> RecomputedGap:
    """Return the bound of a finished or unfinished gap; see :func:`recompute`.

    ``simulated`` is search 1 of a certify, on which the verdict depends; without it s2r reads the folder beside this
    one.
    """
    journals = {side: Journal.read(folder / side) for side in SYSTEMS}
    for side in SYSTEMS:
        _refuse_pilot(folder, journals[side])
        refuse_unrepeatable(folder / side)
    header = journals["real"].header
    spec = _of_both(folder, journals)
    per_real = header["simulated_per_real"]
    search = gap_search(spec, header["requirement"], _options(header), per_real)
    _same_settings(search, header, folder)
    if search.settings.repeats or stop_of(header) == DECIDED:
        first = simulated or recompute(folder.parent / SIMULATION).search
        search.end_when(lambda: decides(first, search))
    pairs = pairs_of(journals, per_real)
    if not pairs:
        raise UsageError(f"{folder} has no pair of rollouts yet, so there is nothing to report")
    outcomes = {(pair.query, pair.replicate): (pair.params, pair.simulated - pair.real) for pair in pairs}
    history = _replay(search, header, outcomes, folder)
    counted = search.certificate().rollouts
    search.close()
    provenance = {key: value for key, value in header.items() if key not in ("side", "backend", "duration")}
    result = conclude_gap(spec, search, journals, provenance, folder)
    return RecomputedGap(
        spec,
        result,
        search,
        history,
        tuple(pairs),
        tuple(journals["sim"].records()),
        tuple(journals["real"].records()),
        len(journals["real"]) - counted,
    )


def _refuse_pilot(folder: Path, journal: Journal) -> None:
    if PILOT in journal.header:
        raise UsageError(
            f"{folder} is a pilot and has no certificate; s2r pilot SPEC --resume {folder} reads it"
        )


def recompute_certify(folder: Path, real: str | None = None) -> RecomputedCertify:
    """Return the certificate of both steps; ``real`` is the machine of a run whose second search did not begin."""
    simulated = recompute(folder / SIMULATION)
    if real is not None and not simulated.result.certificate.label.bounds:
        return RecomputedCertify(
            simulated.spec, refused_in_simulation(simulated.result, real), simulated, None
        )
    gap = recompute_gap(folder / GAP, simulated.search)
    first, second = simulated.result.provenance, gap.result.provenance
    for key in ("spec_hash", "requirement", "seed"):
        if first[key] != second[key]:
            raise UsageError(f"{folder}: simulation and gap differ in {key}, so they belong to two runs")
    if {key: first[key] for key in second["sim"]} != second["sim"]:
        raise UsageError(
            f"{folder}: simulation ({first['backend']}) and gap ({second['sim']['backend']}) used different models, so "
            f"they belong to two runs"
        )
    result = conclude_certify(simulated.search, gap.search, simulated.result, gap.result)
    return RecomputedCertify(simulated.spec, result, simulated, gap)


def _of_both(folder: Path, journals: Mapping[str, Journal]) -> Spec:
    """Return the specification of both halves of a gap's run after all checks."""
    headers = {side: journal.header for side, journal in journals.items()}
    for side, header in headers.items():
        if header.get("side") != side:
            raise UsageError(f"{journals[side].path}:1: this is not the journal of {side!r} in a gap's run")
    own = ("side", "backend", "duration")
    left, right = (
        {key: value for key, value in header.items() if key not in own} for header in headers.values()
    )
    if differ := [key for key in sorted(left.keys() | right.keys()) if left.get(key) != right.get(key)]:
        raise UsageError(f"{folder}: its two journals differ in {differ[0]}, so they belong to two runs")
    *_, spec = (load_run_spec(journal) for journal in journals.values())
    for journal in journals.values():
        journal.check_traces()
    return spec


def _replay(
    search: Search, header: Mapping[str, Any], outcomes: Outcomes, folder: Path
) -> tuple[Certificate, ...]:
    """Pass every complete batch of outcomes to a new search; return its certificate after each."""
    if "recorded" in header:
        tests: dict[int, tuple[Mapping[str, float], list[float]]] = {}
        for (index, _), (params, value) in outcomes.items():
            tests.setdefault(index, (params, []))[1].append(value)
        search.observe(tests.values(), final=True)
        return (search.certificate(),)

    def on_disk(index: int, count: int) -> bool:
        return all((index, number) in outcomes for number in range(count))

    history: list[Certificate] = []
    while queries := next_queries(search, on_disk):
        batch = [_answer(query, outcomes, folder) for query in queries]
        if any(len(values) < query.replicates for query, values in zip(queries, batch, strict=True)):
            break
        for query, values in zip(queries, batch, strict=True):
            search.tell(query, values)
        history.append(search.certificate())
    return tuple(history)


def _answer(query: Query, outcomes: Outcomes, folder: Path) -> list[float]:
    """Return the outcomes of a query that are on disk."""
    keys = [(query.index, replicate) for replicate in range(query.replicates)]
    answers = {key: outcomes[key] for key in keys if key in outcomes}
    for (index, replicate), (params, _) in answers.items():
        if dict(params) != query.point:
            raise UsageError(
                f"rollout {index}.{replicate} of {folder} was run at {dict(params)}, but the search now chooses "
                f"{query.point}: the numerical libraries differ from the libraries of the run"
            )
    return [value for _, value in answers.values()]


def _options(header: Mapping[str, Any]) -> RunOptions:
    settings = header["settings"]
    return RunOptions(
        seed=header["seed"],
        mode=settings["mode"],
        engine=settings["engine"],
        stop=stop_of(header),
        repeats=repeats_of(header),
    )


def _same_settings(search: Search, header: Mapping[str, Any], folder: Path) -> None:
    if search.certificate().settings != header["settings"]:
        raise UsageError(
            f"{folder} was run by s2r {header['s2r']} with settings that this version does not have"
        )
