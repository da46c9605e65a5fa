"""The result of search 2: bounds on the gap, its worst test, and all that they assume."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.check_result import distance, left_out
from s2r_spec.certify.from_spec import rho_unit
from s2r_spec.certify.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.recorded import left_open
from s2r_spec.certify.search import Search
from s2r_spec.certify.voids import is_machine, machine_assumptions, void_counts, with_voids, without_too_many
from s2r_spec.errors import UsageError
from s2r_spec.result import Result
from s2r_spec.rollouts.journal import Journal
from s2r_spec.rollouts.layout import SYSTEMS
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


@dataclass(frozen=True, repr=False)
class GapResult(Result):
    """With probability ≥ 1 − δ, E Δ lies in [low, high] at every test, and its minimum in [lower, upper].

    Attributes:
        requirement: the name of the requirement in the spec.
        lower: lower bound of min_d E Δ: how much worse than simulated the real machine can be.
        upper: upper bound of the same minimum.
        low: lower bound of E Δ anywhere; equals ``lower``.
        high: upper bound of E Δ anywhere.
        unit: the unit of ρ.
        worst: the tested point nearest to the one that shows the most negative gap.
        tested: every tested point.
        lowest: the pair of the most negative Δ.
        failures: the number of failures of real rollouts, by word.
        assumptions: each in one sentence.
        certificate: the certificate of the search, which maximises −Δ.
        provenance: versions, hashes, seed.
        folder: the folder of the rollouts.
        seconds: wall time of all rollouts of both backends [s], summed over workers and resumed processes.
        spec: the specification.
        voids: the number of void rollouts of a machine, by word; None for a simulator.
    """

    requirement: str
    lower: float
    upper: float
    low: float
    high: float
    unit: str
    worst: GapTested
    tested: tuple[GapTested, ...]
    lowest: Pair
    failures: dict[str, int]
    assumptions: tuple[str, ...]
    certificate: Certificate
    provenance: dict[str, Any]
    folder: Path
    seconds: float
    spec: Spec = field(compare=False)
    voids: dict[str, int] | None = None

    @property
    def absolute(self) -> float:
        """The largest mean |Δ| at a tested point: an estimate for comparison with the paper, not a bound."""
        return max(test.absolute for test in self.tested)


def conclude_gap(
    spec: Spec,
    search: Search,
    journals: Mapping[str, Journal],
    provenance: dict[str, Any],
    folder: Path,
) -> GapResult:
    """Return the result of a search whose pairs are all in two journals, from those that it counts.

    Args:
        spec: the specification with the requirement.
        search: the search, with an outcome for every pair.
        journals: the journals of the simulator and the real machine; the keys are the names in ``SYSTEMS``.
        provenance: the journals' common header.
        folder: the folder of both journals.

    Raises:
        UsageError: there is no pair.
    """
    every = pairs_of(journals, provenance["simulated_per_real"])
    pairs = [pair for pair in every if search.counts(pair.query)] or every
    if not pairs:
        raise UsageError("no pair of rollouts was run: the budget is smaller than the first batch")
    tested = _tested(pairs)
    certificate = without_too_many(search.certificate(), provenance["real"]["backend"], journals["real"])
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
        voids=void_counts(journals["real"]) if is_machine(provenance["real"]) else None,
    )


def pairs_of(journals: Mapping[str, Journal], per_real: int) -> list[Pair]:
    """Return the pairs of two journals whose simulated rollouts are all there.

    Args:
        journals: the journals of the simulator and the real machine; the keys are the names in ``SYSTEMS``.
        per_real: simulated rollouts for each real one.
    """
    simulated: dict[tuple[int, int], list[float]] = {}
    # Sorted: a mean of the same numbers in another order differs in its last bit.
    for record in sorted(journals["sim"].records(), key=lambda record: (record.query, record.replicate)):
        key = record.query, record.replicate // SIMULATED_PER_REAL
        simulated.setdefault(key, []).append(record.rho)
    return [
        Pair(
            record.query,
            record.replicate,
            record.params,
            record.rho,
            float(np.mean(simulated[record.query, record.replicate])),
            record.failure,
        )
        for record in journals["real"].records()
        if len(simulated.get((record.query, record.replicate), ())) >= per_real
    ]


def _assumptions(
    spec: Spec,
    search: Search,
    certificate: Certificate,
    journals: Mapping[str, Journal],
    provenance: Mapping[str, Any],
) -> tuple[str, ...]:
    """Return the assumptions of the bounds on the gap, each in one sentence."""
    requirement, real = provenance["requirement"], provenance["real"]["backend"]
    unit, fall = rho_unit(spec, requirement), spec.certify[requirement].fall
    averaged = SIMULATED_PER_REAL if provenance["simulated_per_real"] > 1 else "one or two"
    assumptions = (
        *(
            with_voids(
                text.replace("the expected outcome", "the expected gap E Δ").replace("one rollout", "one Δ"),
                provenance["real"],
            )
            for text in certificate.assumptions
        ),
        f"for simulator and real machine, ρ is R-sub-Gaussian with the spec's R; each Δ is one real rollout "
        f"minus the mean of {averaged} simulated ones",
        f"a rollout that falls or crashes counts as ρ = {fall:g} {unit}".rstrip() + ", simulated or real",
    )
    for side in SYSTEMS:
        assumptions += machine_assumptions(provenance[side]["backend"], provenance[side], journals[side])
    if "recorded" in provenance:
        assumptions += (*provenance["recorded"], *left_open(search, "E Δ"))
    if real.startswith("twin"):
        assumptions += (f"{real} is a twin: a simulator that stands in for hardware, not hardware",)
    return assumptions


def _tested(pairs: Sequence[Pair]) -> list[GapTested]:
    """Group pairs by test point."""
    groups: dict[tuple[float, ...], list[Pair]] = {}
    for pair in pairs:
        groups.setdefault(tuple(pair.params.values()), []).append(pair)
    return [
        GapTested(
            group[0].params,
            len(group),
            float(np.mean([pair.gap for pair in group])),
            float(np.mean([abs(pair.gap) for pair in group])),
        )
        for group in groups.values()
    ]
