"""The result of search 2: bounds on the gap, its worst test, and all that they assume."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from annotated_types import Ge, MinLen

from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_types import Level, Magnitude
from s2r_spec.base.json_values import extend
from s2r_spec.certify.bound.certificate import Certificate
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
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.search.recorded import limitations
from s2r_spec.certify.search.search import Search
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.layout import SYSTEMS
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class GapTested:
    """All pairs at one test point.

    Attributes:
        params: the test.
        pairs: their number.
        mean: mean Δ.
        absolute: mean |Δ|, the paper's quantity; noise alone makes it positive.
    """

    params: dict[str, float]
    pairs: int
    mean: float
    absolute: float


@dataclass(frozen=True)
class Pair:
    """A real rollout, and the mean ρ of the simulated rollouts of the same replicate.

    Attributes:
        query: number of the test, in the order of the search.
        replicate: number of the rollout at this test.
        params: the test.
        real: ρ of the real rollout.
        simulated: mean ρ of the simulated rollouts.
        failure: the failure of the real rollout; None if it reached its end.
        gap: Δ = ρ_real − ρ_sim.
    """

    query: int
    replicate: int
    params: dict[str, float]
    real: float
    simulated: float
    failure: str | None
    gap: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "gap", self.real - self.simulated)


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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


class GapProvenance(RunProvenance):
    """The data that fix the run: the first lines of its journals.

    Attributes:
        simulated_per_real: number of simulated rollouts for each real rollout.
        sim: the simulator.
        real: the real machine.
    """

    simulated_per_real: Annotated[int, Ge(1)]
    sim: BackendProvenance
    real: BackendProvenance


@dataclass(frozen=True, kw_only=True, repr=False)
class GapResult(SearchResult):
    """The result of the search of a gap.

    With probability ≥ 1 − δ, E Δ lies in [low, high] at every test, and its minimum in [lower, upper]: how much worse
    than simulated the real machine can be. The certificate is of the search that maximises −Δ.

    Attributes:
        low: lower bound of E Δ anywhere; equals ``lower``.
        high: upper bound of E Δ anywhere.
        worst: all pairs at the worst test.
        tested: every tested point.
        lowest: the pair of the most negative Δ; simulated is a mean.
        failures: word for a failure → number of real rollouts that ended with it.
        reason: the reason for a refusal, else empty.
    """

    low: float
    high: float
    worst: GapTested
    tested: Annotated[tuple[GapTested, ...], MinLen(1)]
    lowest: Pair

    JSON = (
        "requirement worst_expected_gap band label=certificate.label reason=certificate.reason worst lowest "
        "largest_mean_absolute_gap=absolute failures assumptions tested search provenance=origin folder=folder.__str__ "
        "replay seconds voids"
    )

    @property
    def worst_expected_gap(self) -> WorstExpectedGap:
        """The bounds at the worst test."""
        certificate = self.certificate
        delta = certificate.delta if certificate.label.bounds else None
        return WorstExpectedGap(self.lower, self.upper, self.unit, certificate.epsilon, delta)

    @property
    def band(self) -> Band:
        """The bounds at every test."""
        return Band(self.low, self.high, self.unit)

    @property
    def search(self) -> GapSearch:
        """The certificate."""
        return extend(GapSearch, self.certificate)

    @property
    def origin(self) -> GapProvenance:
        """The data that fix the run."""
        return cast(GapProvenance, self.provenance)

    @property
    def replay(self) -> str:
        """The command that runs the real rollout of the lowest Δ again."""
        return replay_line(self.folder / "real", self.lowest.query, self.lowest.replicate)

    @property
    def absolute(self) -> Magnitude:
        """Mean of abs(Δ), largest at a tested point: an estimate, not a bound."""
        return max(test.absolute for test in self.tested)


def conclude_gap(
    spec: Spec, search: Search, journals: Mapping[str, Journal], provenance: dict[str, Any], folder: Path
) -> GapResult:
    """Return the result of a search whose pairs are all in two journals, from those that it counts.

    The keys of the journals are the names in ``SYSTEMS``.

    Raises:
        UsageError: there is no pair.
    """
    every = pairs_of(journals, provenance["simulated_per_real"])
    pairs = [pair for pair in every if search.counts(pair.query)] or every
    if not pairs:
        raise UsageError("no pair of rollouts was run: the budget is smaller than the first batch")
    tested = [_at_test(group) for group in by_test(pairs)]
    certificate = voids.without_too_many(
        search.certificate(), provenance["real"]["backend"], journals["real"]
    )
    outcomes = [(group[0].params, [-pair.gap for pair in group]) for group in by_query(pairs)]
    certificate = with_remedy(certificate, search, outcomes, judged=False)
    for name in "BR":  # the certificate does not know by which name they were declared
        if getattr(spec.certify[provenance["requirement"]], f"gap_{name}") is not None:
            reason = re.sub(rf"\b{name} (?==|must)", f"gap_{name} ", certificate.reason)
            certificate = replace(certificate, reason=reason)
    lowest, highest = search.range
    return GapResult(
        requirement=provenance["requirement"],
        lower=-certificate.upper,
        upper=-certificate.lower,
        low=-highest,
        high=-lowest,
        unit=rho_unit(spec, provenance["requirement"]),
        worst=min(tested, key=lambda test: distance(spec, test.params, certificate.worst)),
        tested=tuple(tested),
        lowest=min(pairs, key=lambda pair: pair.gap),
        failures=dict(Counter(pair.failure for pair in pairs if pair.failure is not None)),
        assumptions=(
            *_assumptions(spec, search, certificate, journals, provenance),
            *left_out(sum(not search.counts(record.query) for record in journals["real"].records())),
        ),
        certificate=certificate,
        provenance=provenance,
        folder=folder,
        seconds=sum(
            record.seconds
            for journal in journals.values()
            for record in journal.records()
            if search.counts(record.query) or pairs is every
        ),
        spec=spec,
        voids=voids.void_counts(journals["real"]) if voids.is_machine(provenance["real"]) else None,
    )


def _at_test(pairs: Sequence[Pair]) -> GapTested:
    gaps = [pair.gap for pair in pairs]
    return GapTested(pairs[0].params, len(pairs), float(np.mean(gaps)), float(np.mean(np.abs(gaps))))


def pairs_of(journals: Mapping[str, Journal], per_real: int) -> list[Pair]:
    """Return the pairs of two journals whose simulated rollouts, ``per_real`` for each real one, are all there."""
    simulated: dict[tuple[int, int], list[float]] = {}
    # Sorted: a mean of the same numbers in another order differs in its last bit.
    for record in sorted(journals["sim"].records(), key=lambda record: (record.query, record.replicate)):
        key = record.query, record.replicate // SIMULATED_PER_REAL
        simulated.setdefault(key, []).append(record.rho)
    pairs = []
    for record in journals["real"].records():
        own = simulated.get((record.query, record.replicate), [])
        if len(own) >= per_real:
            rhos = record.rho, float(np.mean(own))
            pairs.append(Pair(record.query, record.replicate, record.params, *rhos, record.failure))
    return pairs


def _assumptions(
    spec: Spec,
    search: Search,
    certificate: Certificate,
    journals: Mapping[str, Journal],
    provenance: Mapping[str, Any],
) -> tuple[str, ...]:
    requirement, real = provenance["requirement"], provenance["real"]["backend"]
    unit, fall = rho_unit(spec, requirement), spec.certify[requirement].fall
    texts = [
        text.replace("the expected outcome", "the expected gap E Δ").replace("one rollout", "one Δ")
        for text in certificate.assumptions
    ]
    averaged = SIMULATED_PER_REAL if provenance["simulated_per_real"] > 1 else "one or two"
    whose = "for simulator and real machine, ρ is R-sub-Gaussian with the spec's R"
    if spec.certify[requirement].gap_R is not None:
        whose = "the noise of each Δ is gap_R-sub-Gaussian with the spec's gap_R"
    assumptions = (
        *(voids.with_voids(text, provenance["real"]) for text in texts),
        f"{whose}; each Δ is one real rollout minus the mean of {averaged} simulated ones",
        f"a rollout that falls or crashes counts as ρ = {fall:g} {unit}".rstrip() + ", simulated or real",
    )
    for side in SYSTEMS:
        assumptions += voids.machine_assumptions(
            provenance[side]["backend"], provenance[side], journals[side]
        )
    if "recorded" in provenance:
        assumptions += (*provenance["recorded"], *limitations(search, "E Δ"))
    if real.startswith("twin"):
        assumptions += (f"{real} is a twin: a simulator that stands in for hardware, not hardware",)
    return assumptions
