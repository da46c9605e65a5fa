"""The object of ``s2r gap``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NotRequired

from annotated_types import Ge, MinLen

from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.gap_result import GapTested, Pair
from s2r_spec.json_objects.check import BackendProvenance
from s2r_spec.json_values import OPTIONAL, Count, ExitCode, Failures, Level, Location, Magnitude, Open


@dataclass(frozen=True, kw_only=True)
class WorstExpectedGap:
    """The minimum over the test space of the expected gap Δ = ρ_real − ρ_sim lies in [lower, upper].

    Attributes:
        lower: the lower bound, in the unit.
        upper: the upper bound, in the unit.
        unit: the unit of ρ; empty for none.
        epsilon: upper − lower.
        delta: 1 − probability; null if there is no certificate.
    """

    lower: float
    upper: float
    unit: str
    epsilon: float
    delta: Level | None


@dataclass(frozen=True, kw_only=True)
class Band:
    """The expected gap lies in [low, high] at every test.

    Attributes:
        low: the lower end, in the unit.
        high: the upper end, in the unit.
        unit: the unit of ρ; empty for none.
    """

    low: float
    high: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class _Objective:
    objective: Literal["-delta"] = "-delta"


@dataclass(frozen=True)
class GapSearch(Certificate, _Objective):
    """The certificate of the search, which maximises −Δ: its signs and bounds refer to −Δ.

    Attributes:
        objective: the quantity that the search maximises.
    """


class GapProvenance(Open):
    """The data that fix the run: the first lines of its journals.

    Attributes:
        s2r: version.
        spec: name of the specification's file.
        spec_hash: the hash of the specification.
        requirement: the name of the requirement.
        seed: the seed of the run.
        simulated_per_real: number of simulated rollouts for each real rollout.
        settings: the settings that were declared before the data.
        sim: the simulator.
        real: the real machine.
        stop: the stopping rule; absent for ``epsilon``.
        recorded: the parts of recordings that were left out, each in one sentence; only for recordings.
    """

    s2r: str
    spec: str
    spec_hash: str
    requirement: str
    seed: Count
    simulated_per_real: Annotated[int, Ge(1)]
    settings: dict[str, Any]
    sim: BackendProvenance
    real: BackendProvenance
    stop: NotRequired[Literal["decided", "budget"]]
    recorded: NotRequired[list[str]]


@dataclass(frozen=True, kw_only=True)
class BoundedGap:
    """The result of the search of a gap.

    Attributes:
        requirement: the name of the requirement.
        worst_expected_gap: the bounds at the worst test.
        band: the bounds at every test.
        label: the label of the certificate.
        reason: the reason for a refusal, else empty.
        worst: all pairs at the worst test.
        lowest: the pair of the most negative Δ; simulated is a mean.
        largest_mean_absolute_gap: mean of abs(Δ), largest at a tested point: an estimate, not a bound.
        failures: word for a failure → number of real rollouts that ended with it.
        assumptions: the assumptions, each in one sentence.
        tested: every tested point.
        search: the certificate.
        provenance: the data that fix the run.
        folder: the folder of the rollouts.
        replay: the command that runs the real rollout of the lowest Δ again.
        seconds: wall time of the rollouts [s], summed over all workers and all resumed processes.
        voids: word → number of rollouts that something other than the robot ended; only for a machine.
    """

    requirement: str
    worst_expected_gap: WorstExpectedGap
    band: Band
    label: Label
    reason: str
    worst: GapTested
    lowest: Pair
    largest_mean_absolute_gap: Magnitude
    failures: Failures
    assumptions: Annotated[tuple[str, ...], MinLen(1)]
    tested: Annotated[tuple[GapTested, ...], MinLen(1)]
    search: GapSearch
    provenance: GapProvenance
    folder: str
    replay: str
    seconds: Magnitude
    voids: Failures | None = field(default=None, metadata=OPTIONAL)


@dataclass(frozen=True, kw_only=True)
class _Head:
    schema: Literal["s2r.gap/1"] = "s2r.gap/1"
    exit_code: ExitCode


@dataclass(frozen=True, kw_only=True)
class _Tail:
    location: Location


@dataclass(frozen=True, kw_only=True)
class GapObject(_Tail, BoundedGap, _Head):
    """The result of ``s2r gap``.

    Attributes:
        schema: name and version of this object.
        exit_code: 0 if the interval is at most as wide as the target, else 3.
        location: the place of the requirement in the files.
    """
