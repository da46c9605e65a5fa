"""The object of ``s2r check`` and ``s2r report``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NotRequired

from annotated_types import MinLen

from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.check_result import Tested
from s2r_spec.json_values import (
    OPTIONAL,
    Count,
    ExitCode,
    Failures,
    Level,
    Location,
    Magnitude,
    Open,
    Probability,
)
from s2r_spec.rollouts.journal import Record
from s2r_spec.verdict import Verdict


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
class CheckedRequirement:
    """The result of one requirement.

    Attributes:
        requirement: the name of the requirement.
        verdict: holds, violated or unknown.
        reason: one sentence for the verdict.
        worst_expected_robustness: the bounds.
        label: the label of the certificate.
        worst: all rollouts at the worst test.
        lowest: the rollout of the lowest ρ.
        failures: word for a failure → number of rollouts that ended with it.
        assumptions: the assumptions, each in one sentence.
        search: the certificate.
        provenance: the data that fix the run.
        folder: the folder of the rollouts.
        replay: the command that runs the rollout of the lowest ρ again.
        seconds: wall time of the rollouts [s], summed over all workers and all resumed processes.
        voids: word → number of rollouts that something other than the robot ended; only for a machine.
    """

    requirement: str
    verdict: Verdict
    reason: str
    worst_expected_robustness: WorstExpectedRobustness
    label: Label
    worst: Tested
    lowest: Record
    failures: Failures
    assumptions: Annotated[tuple[str, ...], MinLen(1)]
    search: RobustnessSearch
    provenance: Provenance
    folder: str
    replay: str
    seconds: Magnitude
    voids: Failures | None = field(default=None, metadata=OPTIONAL)


@dataclass(frozen=True, kw_only=True)
class CheckObject:
    """The result of ``s2r check``.

    Attributes:
        schema: name and version of this object.
        exit_code: 0 holds, 1 violated, 3 unknown; the worst over all requirements.
        results: the results, in the order of the requirements.
        locations: requirement → its place in the files.
    """

    schema: Literal["s2r.check/1"] = "s2r.check/1"
    exit_code: ExitCode
    results: Annotated[tuple[CheckedRequirement, ...], MinLen(1)]
    locations: dict[str, Location]
