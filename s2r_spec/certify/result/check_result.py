"""The result of search 1: verdict, certified interval, worst test, and all that it assumes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from s2r_spec.base.json_types import Level, Magnitude, Probability
from s2r_spec.base.json_values import extend
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.certificate import Certificate, Label
from s2r_spec.certify.bound.rounding import at_most
from s2r_spec.certify.result import voids
from s2r_spec.certify.result.refusals import with_remedy
from s2r_spec.certify.result.search_result import (
    BackendProvenance,
    RunProvenance,
    SearchResult,
    by_query,
    by_test,
    distance,
    left_out,
    replay_line,
    rho_unit,
)
from s2r_spec.certify.search.recorded import limitations
from s2r_spec.certify.search.search import Search
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.stop_rule import BUDGET, stop_of
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class Tested:
    """All rollouts at one test point; ``mean``, ``lowest`` and ``highest`` are of ρ."""

    params: dict[str, float]
    rollouts: int
    mean: float
    lowest: float
    highest: float


@dataclass(frozen=True)
class WorstExpectedRobustness:
    """The minimum over the test space of the expected ρ lies in [lower, upper].

    Attributes:
        lower: the lower bound, in the unit; not certified if the label is one-sided.
        upper: the upper bound, in the unit.
        unit: the unit of ρ; empty for none, 'mixed' if margins do not compare.
        epsilon: upper − lower; negative only if the certificate is refused because its bounds contradict each other.
        probability_at_least: 1 − delta.
        delta: 1 − probability_at_least, without rounding.
    """

    lower: float
    upper: float
    unit: str
    epsilon: float
    probability_at_least: Probability
    delta: Level


@dataclass(frozen=True, kw_only=True)
class _Objective:
    objective: Literal["-rho"] = "-rho"


@dataclass(frozen=True)
class RobustnessSearch(Certificate, _Objective):
    """The certificate of the search, which maximises −ρ: its signs and bounds refer to −ρ.

    Attributes:
        objective: the quantity that the search maximises.
    """


class Provenance(BackendProvenance, RunProvenance):
    """The data that fix the run: the first line of its journal.

    Attributes:
        duration: the duration of a rollout [s].
    """

    duration: Magnitude


@dataclass(frozen=True, kw_only=True, repr=False)
class CheckResult(SearchResult):
    """The result of one requirement.

    The worst expected robustness ρ̂* = min over D of E ρ lies in [lower, upper] with probability ≥ 1 − δ. The lower
    bound is not certified if the label is one-sided. The certificate of the search, which maximises −ρ, is then the
    one-sided one.

    Attributes:
        verdict: holds, violated or unknown.
        reason: one sentence for the verdict.
        worst: all rollouts at the worst test.
        lowest: the rollout of the lowest ρ.
        failures: word for a failure → number of rollouts that ended with it.
    """

    verdict: Verdict
    reason: str
    worst: Tested
    lowest: Record

    JSON = (
        "requirement verdict reason worst_expected_robustness label=certificate.label worst lowest failures "
        "assumptions search provenance=origin folder=folder.__str__ replay seconds voids"
    )

    @property
    def worst_expected_robustness(self) -> WorstExpectedRobustness:
        """The bounds."""
        certificate = self.certificate
        bounds = self.lower, self.upper, self.unit
        return WorstExpectedRobustness(*bounds, certificate.epsilon, 1 - certificate.delta, certificate.delta)

    @property
    def search(self) -> RobustnessSearch:
        """The certificate."""
        return extend(RobustnessSearch, self.certificate)

    @property
    def origin(self) -> Provenance:
        """The data that fix the run."""
        return cast(Provenance, self.provenance)

    @property
    def replay(self) -> str:
        """The command that runs the rollout of the lowest ρ again."""
        return replay_line(self.folder, self.lowest.query, self.lowest.replicate)


def conclude(spec: Spec, search: Search, journal: Journal, provenance: dict[str, Any]) -> CheckResult:
    """Return the result of a search whose outcomes are all in a journal.

    It is about the rollouts that the search counts. Before its first complete batch it shows those on disk.
    """
    requirement, backend = provenance["requirement"], provenance["backend"]
    every, unit = journal.records(), rho_unit(spec, requirement)
    records = [record for record in every if search.counts(record.query)] or every
    certificate = voids.without_too_many(search.one_sided() or search.certificate(), backend, journal)
    outcomes = [(group[0].params, [-record.rho for record in group]) for group in by_query(records)]
    certificate = with_remedy(certificate, search, outcomes)
    lower, upper = -certificate.upper, -certificate.lower
    verdict, reason = _judge(certificate, lower, upper, stop_of(provenance))
    about = (
        "the statement is about this backend's expected ρ over its own noise; the real machine is search 2"
    )
    if voids.is_machine(provenance):
        about = "the statement is about this machine's expected ρ, as it was during these rollouts"
    recorded: list[str] = []
    if "recorded" in provenance:
        about = "the statement is about the machine as it was when it was recorded"
        recorded = [*provenance["recorded"], *limitations(search, "E ρ")]
        reason = _reason_of_recordings(verdict, reason, certificate, search)
    texts = [
        text.replace("the expected outcome", "the expected robustness E ρ")
        for text in certificate.assumptions
    ]
    assumptions = (
        *(voids.with_voids(text, provenance) for text in texts),
        f"a rollout that falls or crashes counts as ρ = {spec.certify[requirement].fall:g} {unit}".rstrip()
        + ", as the spec declares",
        *left_out(sum(not search.counts(record.query) for record in every)),
        *voids.machine_assumptions(backend, provenance, journal),
        about,
        *recorded,
    )
    return CheckResult(
        requirement=requirement,
        verdict=verdict,
        reason=reason,
        lower=lower,
        upper=upper,
        unit=unit,
        worst=min(group_by_test(records), key=lambda test: distance(spec, test.params, certificate.worst)),
        lowest=min(records, key=lambda record: record.rho),
        failures=dict(Counter(record.failure for record in records if record.failure is not None)),
        assumptions=assumptions,
        certificate=certificate,
        provenance=provenance,
        folder=journal.folder,
        seconds=sum(record.seconds for record in records),
        spec=spec,
        voids=voids.void_counts(journal) if voids.is_machine(provenance) else None,
    )


def _reason_of_recordings(verdict: Verdict, reason: str, certificate: Certificate, search: Search) -> str:
    """Return the reason for the verdict of recordings, with what their tests cannot certify."""
    if verdict is Verdict.UNKNOWN and certificate.label is not Label.REFUSED:
        reason = f"the interval contains 0 after {certificate.rollouts} recorded rollouts"
    if certificate.label is Label.BUDGET:
        where = ", ".join(f"{name} = {value:.4g}" for name, value in search.suggestion.items())
        reason += (
            f"; the recorded tests certify an interval {at_most(certificate.epsilon)} wide, wider than "
            f"ε = {certificate.target:g}; another test would help most at {where}"
        )
    return reason


def group_by_test(records: Sequence[Record]) -> list[Tested]:
    """Group rollouts by test point."""
    tests = []
    for group in by_test(records):
        rhos = [record.rho for record in group]
        tests.append(Tested(group[0].params, len(group), float(np.mean(rhos)), min(rhos), max(rhos)))
    return tests


def when_decided(label: Label) -> str:
    """Return the end of a verdict's reason: whether the search ended because the verdict was known."""
    return "; the search ended because this was known" if label is Label.DECIDED else ""


def _judge(certificate: Certificate, lower: float, upper: float, stop: str) -> tuple[Verdict, str]:
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
