"""The object of ``s2r gap``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NotRequired

from annotated_types import Ge, MinLen

from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.gap_result import GapTested, Pair
from s2r_spec.json_objects.check import BackendProvenance
from s2r_spec.json_objects.parts import Count, ExitCode, Failures, Level, Location, Magnitude, Open
from s2r_spec.json_values import OPTIONAL


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
        objective: what the search maximises.
    """


class GapProvenance(Open):
    """What fixes the run, as its journals begin.

    Attributes:
        s2r: version.
        spec: name of the specification's file.
        spec_hash: the hash of the specification.
        requirement: the name of the requirement.
        seed: the seed of the run.
        simulated_per_real: simulated rollouts for each real one.
        settings: what was declared before the data.
        sim: the simulator.
        real: the real machine.
        recorded: only of recordings: what was left out, a sentence each.
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
    recorded: NotRequired[list[str]]


@dataclass(frozen=True, kw_only=True)
class BoundedGap:
    """The result of the search of a gap.

    Attributes:
        requirement: the name of the requirement.
        worst_expected_gap: the bounds at the worst test.
        band: the bounds at every test.
        label: what the certificate may be called.
        reason: why it was refused, else empty.
        worst: all pairs at the worst test.
        lowest: the pair of the most negative Δ; simulated is a mean.
        largest_mean_absolute_gap: mean of abs(Δ), largest at a tested point: an estimate, not a bound.
        failures: word → how many real rollouts ended so.
        assumptions: each in one sentence.
        tested: every tested point.
        search: the certificate.
        provenance: what fixes the run.
        folder: where the rollouts lie.
        replay: the command that runs the real rollout of the lowest Δ again.
        seconds: what the rollouts took, all workers and all resumed processes added up.
        voids: only of a machine: word → how many rollouts were void, ended by something other than the robot.
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
        exit_code: 0 the interval is as narrow as was asked, 3 it is not.
        location: where the requirement is written.
    """
