"""Search 2: how much worse than simulated can the real machine be.

The gap is sampled signed, Δ(d) = ρ_real − ρ_sim, from independent rollouts of both
sides. E|Δ|, which the paper bounds, is not zero even for two identical noisy
systems (2s/√π for noise of deviation s); it is given beside, as an estimate.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.backend import Operator, is_exclusive
from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.check import (
    distance,
    only_requirement,
    rho_unit,
    search_for,
)
from s2r_spec.certify.drive import Experiment, Observer, Pairs, Phase, Rollouts, drive
from s2r_spec.certify.given import given_folder, given_name, given_spec, must_be_begun
from s2r_spec.certify.recorded import Recorded, left_open, observe
from s2r_spec.certify.search import Search
from s2r_spec.certify.sides import SIMULATED_PER_REAL, Sides
from s2r_spec.certify.voids import about, assumed, counted, is_machine, with_voids, without_too_many
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.attempts import AGAIN
from s2r_spec.rollouts.attendance import Terms, refuse_terms, terms_of
from s2r_spec.rollouts.attended import attending
from s2r_spec.rollouts.journal import Journal
from s2r_spec.rollouts.kept import files_of
from s2r_spec.rollouts.layout import SIDES
from s2r_spec.rollouts.pools import ExecutorFactory, process_pool
from s2r_spec.rollouts.runner import Runner
from s2r_spec.rollouts.seeds import Stream
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class GapTested:
    """All pairs at one test point.

    Attributes:
        params: the test.
        pairs: how many.
        mean: mean Δ.
        absolute: mean |Δ|, the paper's quantity; of noise alone it is not 0.
    """

    params: dict[str, float]
    pairs: int
    mean: float
    absolute: float


@dataclass(frozen=True)
class Pair:
    """A real rollout and the mean ρ of the simulated ones that it is compared with.

    Attributes:
        query: number of the test, in the order of the search.
        replicate: number of the rollout at this test.
        params: the test.
        real: ρ of the real rollout.
        simulated: mean ρ of the simulated ones.
        failure: of the real rollout; None if it reached its end.
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
class GapResult:
    """With probability ≥ 1 − δ, E Δ lies in [low, high] at every test, and its minimum in [lower, upper].

    Attributes:
        requirement: its name in the spec.
        lower: lower bound of min_d E Δ: how much worse than simulated the real machine can be.
        upper: upper bound of the same minimum.
        low: lower bound of E Δ anywhere; equals ``lower``.
        high: upper bound of E Δ anywhere.
        unit: of ρ.
        worst: the tested point nearest to the one that shows the most negative gap.
        tested: every tested point.
        lowest: the pair of the most negative Δ.
        failures: of real rollouts, by word.
        assumptions: each in one sentence.
        certificate: of the search, which maximises −Δ.
        provenance: versions, hashes, seed.
        folder: where the rollouts lie.
        seconds: that the rollouts of both sides took, all workers and all resumed processes added up.
        voids: of a machine, how many of its rollouts were void, by word; None of what is none.
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
    voids: dict[str, int] | None = None

    @property
    def absolute(self) -> float:
        """The largest mean |Δ| at a tested point: an estimate for comparison with the paper, no bound."""
        return max(test.absolute for test in self.tested)


def gap_search(
    spec: Spec,
    requirement: str,
    *,
    seed: int,
    budget: int | None,
    mode: str,
    engine: str,
    per_real: int = SIMULATED_PER_REAL,
) -> Search:
    """Build search 2 from the spec's certify line.

    The noise of Δ has proxy R·sqrt(1 + 1/k), if R is the real machine's too and k
    (``per_real``) simulated rollouts are averaged; B, ε, δ and the kernel are those of search 1.
    """
    return search_for(
        spec,
        requirement,
        seed=seed,
        budget=budget,
        mode=mode,
        engine=engine,
        noise=math.sqrt(1 + 1 / per_real),
    )


def gap(
    spec: Spec,
    simulated: str,
    real: str,
    folder: Path | str,
    *,
    requirement: str | None = None,
    seed: int = 0,
    budget: int | None = None,
    mode: str = "rigorous",
    engine: str = "spectral",
    executor: ExecutorFactory | None = None,
    timeout: float | None = None,
    resume: bool = False,
    observer: Observer | None = None,
    void: str = AGAIN,
    operator: Operator | None = None,
) -> GapResult:
    """Bound the signed gap between two backends over the spec's test space.

    Args:
        spec: with a test space and a certify line.
        simulated: the backend that stands for the simulator.
        real: the backend that stands for the real machine: a robot, its logs, a twin. Of logs every
            recording inside the test space counts once, and the simulator is run at the same tests
            (or its own logs are read); the search then chooses no test.
        folder: of the journals and traces of both sides.
        requirement: may be left out when the spec has one.
        seed: of the whole run.
        budget: most real rollouts; None for as many as the spec's ε takes.
        mode: of the confidence set.
        engine: of the Gaussian process.
        executor: makes the pool; two local processes by default.
        timeout: see :func:`s2r_spec.certify.check.check`.
        resume: go on with the run in ``folder``.
        observer: is told of batches and real rollouts.
        void: see :func:`s2r_spec.certify.check.check`.
        operator: see there.

    Raises:
        UsageError: spec, backends and folder do not fit together.
        BackendError: a rollout raised; all that came before is in the journals.
    """
    spec, folder = given_spec(spec), given_folder(folder)
    simulated, real = given_name(simulated, "simulated"), given_name(real, "real")
    requirement = requirement or only_requirement(spec)
    if resume:
        must_be_begun([folder / side for side in SIDES], folder)
    sides = Sides.of(spec, requirement, simulated, real, budget)
    search = gap_search(
        spec, requirement, seed=seed, budget=budget, mode=mode, engine=engine, per_real=sides.per_real
    )
    terms = terms_of(void, operator)
    return gap_with(
        search, spec, requirement, sides, folder, seed, executor, timeout, resume, observer, terms
    )


def gap_with(
    search: Search,
    spec: Spec,
    requirement: str,
    sides: Sides,
    folder: Path,
    seed: int,
    executor: ExecutorFactory | None,
    timeout: float | None,
    resume: bool,
    observer: Observer | None,
    terms: Terms | None = None,
) -> GapResult:
    """Run a search for the gap to its end; see :func:`gap`."""
    terms = terms or Terms()
    refuse_terms(sides.real.backend, terms)
    if sides.recorded is None:
        search.refuse_hopeless()
    rigs = {"sim": sides.sim, "real": sides.real}
    provenance: dict[str, Any] = {
        "s2r": version("s2r"),
        "spec": Path(spec.name).name,
        "spec_hash": spec.hash,
        "requirement": requirement,
        "seed": seed,
        "simulated_per_real": sides.per_real,
        "settings": search.certificate().settings,
    }
    for side, rig in rigs.items():
        about_side = {"backend": rig.name, "model_hash": rig.backend.model_hash}
        provenance[side] = about_side | about(rig.backend, terms.void)
    if sides.recorded is not None:
        provenance["recorded"] = list(sides.notes)
    journals = {}
    for side, rig in rigs.items():
        header = provenance | {"side": side, "backend": rig.name, "duration": rig.backend.duration}
        place = folder / side
        journals[side] = (
            Journal.resume(place, header)
            if resume and Journal.begun(place)
            else Journal.create(place, header, files_of(spec))
        )
    if observer is not None:
        unit = rho_unit(spec, requirement)
        source = sides.real.name if sides.recorded is None else sides.sim.name
        attended = is_exclusive(sides.real.backend)
        observer.begin(Phase("Δ", unit, source, spec.space.units, search.budget, attended))
    with (
        Runner(executor or process_pool(2), timeout) as runner,
        attending(runner, sides.real.backend, journals["real"], terms, search.budget) as machine,
    ):
        simulated: Experiment = Rollouts(
            rigs["sim"], seed, journals["sim"], runner, Stream.GAP_SIM, SIMULATED_PER_REAL
        )
        if sides.recorded is None:
            real = Rollouts(rigs["real"], seed, journals["real"], machine, Stream.GAP_REAL)
            drive(search, Pairs(simulated, real), observer)
        else:
            if sides.simulated is not None:
                simulated = Recorded(sides.simulated, rigs["sim"], journals["sim"], SIMULATED_PER_REAL)
            recorded = Recorded(sides.recorded, rigs["real"], journals["real"])
            observe(search, sides.recorded, Pairs(simulated, recorded, watched="simulated"), observer)
    return conclude_gap(spec, search, journals, provenance, folder)


def conclude_gap(
    spec: Spec,
    search: Search,
    journals: Mapping[str, Journal],
    provenance: dict[str, Any],
    folder: Path,
) -> GapResult:
    """Return what a search that was told every pair of the journals (of both ``SIDES``) means."""
    requirement, real = provenance["requirement"], provenance["real"]["backend"]
    per_real = provenance["simulated_per_real"]
    fall = spec.certify[requirement].fall
    found = pairs_of(journals, per_real)
    if not found:
        raise UsageError("no pair of rollouts was run: the budget is smaller than the first batch")
    tested = _tested(found)
    certificate = without_too_many(search.certificate(), real, journals["real"])
    unit = rho_unit(spec, requirement)
    lowest, highest = search.range
    assumptions = (
        *(
            with_voids(
                text.replace("the expected outcome", "the expected gap E Δ").replace("one rollout", "one Δ"),
                provenance["real"],
            )
            for text in certificate.assumptions
        ),
        f"the real machine's ρ is R-sub-Gaussian with the spec's R, like the simulator's; each Δ is one real rollout "
        f"minus the mean of {SIMULATED_PER_REAL if per_real > 1 else 'one or two'} simulated ones",
        f"a rollout that falls or crashes counts as ρ = {fall:g} {unit}".rstrip() + " on both sides",
    )
    for side in SIDES:
        assumptions += assumed(provenance[side]["backend"], provenance[side], journals[side])
    if "recorded" in provenance:
        assumptions += (*provenance["recorded"], *left_open(search, "E Δ"))
    if real.startswith("twin"):
        assumptions += (f"{real} is a twin: a simulator that stands in for hardware, not hardware",)
    return GapResult(
        requirement=requirement,
        lower=-certificate.upper,
        upper=-certificate.lower,
        low=-highest,
        high=-lowest,
        unit=unit,
        worst=min(tested, key=lambda test: distance(spec, test.params, certificate.worst)),
        tested=tuple(tested),
        lowest=min(found, key=lambda pair: pair.gap),
        failures=dict(Counter(pair.failure for pair in found if pair.failure is not None)),
        assumptions=assumptions,
        certificate=certificate,
        provenance=provenance,
        folder=folder,
        seconds=sum(record.seconds for journal in journals.values() for record in journal.records()),
        voids=counted(journals["real"]) if is_machine(provenance["real"]) else None,
    )


def pairs_of(journals: Mapping[str, Journal], per_real: int) -> list[Pair]:
    """Return the pairs of two journals (of both ``SIDES``) that have all simulated rollouts of theirs."""
    simulated: dict[tuple[int, int], list[float]] = {}
    # Not as they came: a mean of the same numbers in another order is another one in its last bit.
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
