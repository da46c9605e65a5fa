"""The result of search 1: verdict, certified interval, worst test, and all that it assumes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.from_spec import rho_unit
from s2r_spec.certify.recorded import left_open
from s2r_spec.certify.rounding import at_most
from s2r_spec.certify.search import Search
from s2r_spec.certify.voids import is_machine, machine_assumptions, void_counts, with_voids, without_too_many
from s2r_spec.result import Result
from s2r_spec.rollouts.journal import Journal, Record
from s2r_spec.rollouts.stop_rule import BUDGET, stop_of
from s2r_spec.spec import Spec
from s2r_spec.verdict import Verdict


@dataclass(frozen=True)
class Tested:
    """All rollouts at one test point; ``mean``, ``lowest`` and ``highest`` are of ρ."""

    params: dict[str, float]
    rollouts: int
    mean: float
    lowest: float
    highest: float


@dataclass(frozen=True, repr=False)
class CheckResult(Result):
    """The worst expected robustness ρ̂* = min over D of E ρ lies in [lower, upper] with probability ≥ 1 − δ.

    Attributes:
        requirement: the name of the requirement in the spec.
        verdict: see :class:`Verdict`; never HOLDS or VIOLATED for a refused certificate.
        reason: one sentence for the verdict.
        lower: certified lower bound, in ``unit``; not certified if the label is one-sided.
        upper: certified upper bound, in ``unit``.
        unit: the unit of ρ; "" when the requirement mixes units.
        worst: the tested point nearest to the one that bounds the worst expected ρ from above.
        lowest: the rollout of the smallest ρ.
        failures: word for a failure → number of rollouts that ended with it.
        assumptions: each in one sentence.
        certificate: the certificate of the search, which maximises −ρ; the one-sided one if that shows a violation.
        provenance: version, spec and model hashes, seed.
        folder: the folder of the rollouts.
        seconds: wall time of all rollouts [s], summed over workers and resumed processes.
        spec: the specification.
        voids: the number of void rollouts of a machine, by word; None for a simulator.
    """

    requirement: str
    verdict: Verdict
    reason: str
    lower: float
    upper: float
    unit: str
    worst: Tested
    lowest: Record
    failures: dict[str, int]
    assumptions: tuple[str, ...]
    certificate: Certificate
    provenance: dict[str, Any]
    folder: Path
    seconds: float
    spec: Spec = field(compare=False)
    voids: dict[str, int] | None = None


def conclude(
    spec: Spec,
    requirement: str,
    fall: float,
    search: Search,
    journal: Journal,
    provenance: dict[str, Any],
) -> CheckResult:
    """Return the result of a search whose outcomes are all in a journal.

    It is about the rollouts that the search counts. Before its first complete batch it shows those on disk.

    Args:
        spec: the specification with the requirement.
        requirement: the name of the requirement.
        fall: declared ρ of a rollout that falls, in the unit of ρ.
        search: the search.
        journal: the journal of its rollouts.
        provenance: the journal's header.
    """
    every, backend = journal.records(), provenance["backend"]
    records = [record for record in every if search.counts(record.query)] or every
    certificate = without_too_many(search.one_sided() or search.certificate(), backend, journal)
    failures = Counter(record.failure for record in records if record.failure is not None)
    lower, upper = -certificate.upper, -certificate.lower
    unit = rho_unit(spec, requirement)
    verdict, reason = _judge(certificate, lower, upper, stop_of(provenance))
    assumptions = (
        *(
            with_voids(text.replace("the expected outcome", "the expected robustness E ρ"), provenance)
            for text in certificate.assumptions
        ),
        f"a rollout that falls or crashes counts as ρ = {fall:g} {unit}".rstrip() + ", as the spec declares",
        *left_out(sum(not search.counts(record.query) for record in every)),
        *machine_assumptions(backend, provenance, journal),
        "the statement is about this machine's expected ρ, as it was during these rollouts"
        if is_machine(provenance)
        else "the statement is about this backend's expected ρ over its own noise; the real machine is search 2",
    )
    return CheckResult(
        requirement=requirement,
        verdict=verdict,
        reason=reason,
        lower=lower,
        upper=upper,
        unit=unit,
        worst=min(tested(records), key=lambda test: distance(spec, test.params, certificate.worst)),
        lowest=min(records, key=lambda record: record.rho),
        failures=dict(failures),
        assumptions=assumptions,
        certificate=certificate,
        provenance=provenance,
        folder=journal.folder,
        seconds=sum(record.seconds for record in records),
        spec=spec,
        voids=void_counts(journal) if is_machine(provenance) else None,
    )


def left_out(rollouts: int) -> tuple[str, ...]:
    """Return a sentence on the real or simulated rollouts of an incomplete last batch; none if there are none."""
    return (
        (f"{rollouts} rollouts of an incomplete last batch are on disk and not counted",) if rollouts else ()
    )


def of_recordings(result: CheckResult, notes: Sequence[str], search: Search) -> CheckResult:
    """Return a result of recordings with their notes, and with what the recorded tests cannot certify.

    Args:
        result: the result of :func:`conclude`.
        notes: the notes of the :class:`~s2r_spec.certify.recorded.Design`.
        search: the search, with the recorded outcomes.
    """
    certificate, reason = result.certificate, result.reason
    if result.verdict is Verdict.UNKNOWN and certificate.label is not Label.REFUSED:
        reason = f"the interval contains 0 after {certificate.rollouts} recorded rollouts"
    if certificate.label is Label.BUDGET:
        where = ", ".join(f"{name} = {value:.4g}" for name, value in search.suggestion.items())
        reason += (
            f"; the recorded tests certify an interval {at_most(certificate.epsilon)} wide, wider than "
            f"ε = {certificate.target:g}; another test would help most at {where}"
        )
    *assumptions, _ = result.assumptions
    about = "the statement is about the machine as it was when it was recorded"
    notes = [*notes, *left_open(search, "E ρ")]
    return replace(result, reason=reason, assumptions=(*assumptions, about, *notes))


def tested(records: Sequence[Record]) -> list[Tested]:
    """Group rollouts by test point."""
    groups: dict[tuple[float, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record.params.values()), []).append(record)
    return [
        Tested(
            params=group[0].params,
            rollouts=len(group),
            mean=float(np.mean([record.rho for record in group])),
            lowest=min(record.rho for record in group),
            highest=max(record.rho for record in group),
        )
        for group in groups.values()
    ]


def distance(spec: Spec, left: Mapping[str, float], right: Mapping[str, float]) -> float:
    """Return the distance of two tests as a share of the test space's width, on the axis where it is largest."""
    return max(abs(left[axis.name] - right[axis.name]) / axis.width for axis in spec.space.axes)


def when_decided(label: Label) -> str:
    """Return the end of a verdict's reason: whether the search ended because the verdict was known."""
    return "; the search ended because this was known" if label is Label.DECIDED else ""


def _judge(certificate: Certificate, lower: float, upper: float, stop: str) -> tuple[Verdict, str]:
    """Return the verdict on certified bounds of the worst expected robustness, with its reason."""
    if certificate.label is Label.ONE_SIDED:
        return Verdict.VIOLATED, (
            f"the worst expected robustness is negative for every B and every kernel; the interval is refused: "
            f"{certificate.reason}"
        )
    if not certificate.label.bounds:
        return Verdict.UNKNOWN, f"no certificate: {certificate.reason}"
    early = when_decided(certificate.label)
    if lower >= 0:
        return Verdict.HOLDS, f"the worst expected robustness is not negative{early}"
    if upper < 0:
        return Verdict.VIOLATED, f"the worst expected robustness is negative{early}"
    spent = certificate.label is Label.BUDGET or stop == BUDGET
    way = "a larger budget" if spent else "a smaller epsilon in its certify line"
    return Verdict.UNKNOWN, (
        f"the interval contains 0 after {certificate.rollouts} rollouts; {way} may decide it"
    )
