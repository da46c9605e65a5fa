"""The result of search 1: verdict, certified interval, worst test, and all that it assumes."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, cast

import numpy as np
from annotated_types import MinLen

from s2r_spec.base.json_values import (
    DIGITS,
    OPTIONAL,
    Count,
    Failures,
    Level,
    Magnitude,
    Open,
    Probability,
    Shown,
    extend,
)
from s2r_spec.base.result import Result
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.certificate import Certificate, Label
from s2r_spec.certify.bound.rounding import at_most
from s2r_spec.certify.result.voids import (
    is_machine,
    machine_assumptions,
    void_counts,
    with_voids,
    without_too_many,
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


class BackendProvenance(Open):
    """The data that fix a backend's answers.

    Attributes:
        backend: the name of the backend, as in ``--backend``.
        model_hash: the hash of the model, which changes whenever traces could.
        assumptions: the assumptions of every statement about this backend.
        void: the treatment of a void rollout; only for a machine.
        reading: the number of the rule by which messages become samples; only for logs.
    """

    backend: str
    model_hash: str
    assumptions: NotRequired[list[str]]
    void: NotRequired[Literal["again", "fall"]]
    reading: NotRequired[Count]


class Provenance(BackendProvenance):
    """The data that fix the run: the first line of its journal.

    Attributes:
        s2r: version.
        spec: name of the specification's file.
        spec_hash: the hash of the specification.
        requirement: the name of the requirement.
        duration: the duration of a rollout [s].
        seed: the seed of the run.
        settings: the settings that were declared before the data.
        stop: the stopping rule; absent for ``epsilon``.
        recorded: the parts of recordings that were left out, each in one sentence; only for recordings.
    """

    s2r: str
    spec: str
    spec_hash: str
    requirement: str
    duration: Magnitude
    seed: Count
    settings: dict[str, Any]
    stop: NotRequired[Literal["decided", "budget"]]
    recorded: NotRequired[list[str]]


@dataclass(frozen=True, repr=False)
class CheckResult(Result, Shown):
    """The result of one requirement.

    The worst expected robustness ρ̂* = min over D of E ρ lies in [lower, upper] with probability ≥ 1 − δ.

    Attributes:
        requirement: the name of the requirement.
        verdict: holds, violated or unknown.
        reason: one sentence for the verdict.
        lower: certified lower bound, in ``unit``; not certified if the label is one-sided.
        upper: certified upper bound, in ``unit``.
        unit: the unit of ρ; "" when the requirement mixes units.
        worst: all rollouts at the worst test.
        lowest: the rollout of the lowest ρ.
        failures: word for a failure → number of rollouts that ended with it.
        assumptions: the assumptions, each in one sentence.
        label: the label of the certificate.
        certificate: the certificate of the search, which maximises −ρ; the one-sided one if that shows a violation.
        provenance: the data that fix the run.
        folder: the folder of the rollouts.
        seconds: wall time of the rollouts [s], summed over all workers and all resumed processes.
        spec: the specification.
        voids: word → number of rollouts that something other than the robot ended; only for a machine.
    """

    requirement: str
    verdict: Verdict
    reason: str
    lower: float
    upper: float
    unit: str
    worst: Tested
    lowest: Record
    failures: Failures
    assumptions: Annotated[tuple[str, ...], MinLen(1)]
    certificate: Certificate
    provenance: dict[str, Any]
    folder: Path
    seconds: Magnitude = field(metadata={DIGITS: 3})
    spec: Spec = field(compare=False)
    voids: Failures | None = field(default=None, metadata=OPTIONAL)

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


def replay_line(folder: Path, query: int, replicate: int) -> str:
    """Return the shell command that runs a rollout again."""
    return f"s2r replay {shlex.quote(str(folder))}#{query}.{replicate}"


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
        worst=min(group_by_test(records), key=lambda test: distance(spec, test.params, certificate.worst)),
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
        notes: the notes of the :class:`~s2r_spec.certify.search.recorded.Design`.
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
    notes = [*notes, *limitations(search, "E ρ")]
    return replace(result, reason=reason, assumptions=(*assumptions, about, *notes))


def group_by_test(records: Sequence[Record]) -> list[Tested]:
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


def rho_unit(spec: Spec, requirement: str) -> str:
    """Return the unit of ρ, "" when the requirement mixes units that do not compare."""
    unit = spec.unit(requirement)
    return "" if unit == "mixed" else unit
