"""Search 2: how much worse than simulated can the real machine be, and what that leaves to promise.

The gap is sampled signed, Δ(d) = ρ_real − ρ_sim, from independent rollouts of both
sides. E|Δ|, which the paper bounds, is not zero even for two identical noisy
systems (2s/√π for noise of deviation s); it is given beside, as an estimate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.check import (
    CheckResult,
    Verdict,
    check_with,
    distance,
    only_requirement,
    rho_unit,
    search_for,
)
from s2r_spec.certify.compose import Composition, compose
from s2r_spec.certify.drive import Experiment, Observer, Pairs, Rollouts, drive
from s2r_spec.certify.recorded import Recorded, left_open, observe
from s2r_spec.certify.search import Search
from s2r_spec.certify.sides import SIMULATED_PER_REAL, Sides
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.journal import Journal
from s2r_spec.rollouts.rig import spec_files
from s2r_spec.rollouts.runner import ExecutorFactory, Runner, process_pool
from s2r_spec.rollouts.seeds import Stream
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class GapTested:
    """All pairs at one test point."""

    params: dict[str, float]
    pairs: int
    mean: float
    """Mean Δ."""
    absolute: float
    """Mean |Δ|, the paper's quantity; of noise alone it is not 0."""


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
        failures: of real rollouts, by word.
        assumptions: each in one sentence.
        certificate: of the search, which maximises −Δ.
        provenance: versions, hashes, seed.
        folder: where the rollouts lie.
        seconds: wall time of this process.
    """

    requirement: str
    lower: float
    upper: float
    low: float
    high: float
    unit: str
    worst: GapTested
    tested: tuple[GapTested, ...]
    failures: dict[str, int]
    assumptions: tuple[str, ...]
    certificate: Certificate
    provenance: dict[str, Any]
    folder: Path
    seconds: float

    @property
    def absolute(self) -> float:
        """The largest mean |Δ| at a tested point: an estimate for comparison with the paper, no bound."""
        return max(test.absolute for test in self.tested)


@dataclass(frozen=True)
class CertifyResult:
    """Both searches and what they promise together.

    Attributes:
        verdict: HOLDS if the composed interval is ≥ 0, VIOLATED if it is < 0, else UNKNOWN.
        reason: one sentence for the verdict.
        real: the backend that the promise is about.
        simulated: search 1.
        gap: search 2; None if search 1 has no certificate, for then no rollout of the real machine is run.
        composition: the promise about the real machine; None if one of the searches has no certificate.
    """

    verdict: Verdict
    reason: str
    real: str
    simulated: CheckResult
    gap: GapResult | None
    composition: Composition | None


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
    folder: Path,
    *,
    requirement: str | None = None,
    seed: int = 0,
    budget: int | None = None,
    mode: str = "rigorous",
    engine: str = "spectral",
    executor: ExecutorFactory | None = None,
    resume: bool = False,
    observer: Observer | None = None,
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
        resume: go on with the run in ``folder``.
        observer: is told of batches and real rollouts.

    Raises:
        UsageError: spec, backends and folder do not fit together.
        BackendError: a rollout raised; all that came before is in the journals.
    """
    requirement = requirement or only_requirement(spec)
    sides = Sides.of(spec, requirement, simulated, real, budget)
    search = gap_search(
        spec, requirement, seed=seed, budget=budget, mode=mode, engine=engine, per_real=sides.per_real
    )
    return gap_with(search, spec, requirement, sides, folder, seed, executor, resume, observer)


def gap_with(
    search: Search,
    spec: Spec,
    requirement: str,
    sides: Sides,
    folder: Path,
    seed: int,
    executor: ExecutorFactory | None,
    resume: bool,
    observer: Observer | None,
) -> GapResult:
    """Run a search for the gap to its end; see :func:`gap`."""
    start = perf_counter()
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
        provenance[side] = {"backend": rig.name, "model_hash": rig.backend.model_hash}
    if sides.recorded is not None:
        provenance["recorded"] = list(sides.notes)
    journals = {}
    for side, rig in rigs.items():
        header = provenance | {"side": side, "backend": rig.name, "duration": rig.backend.duration}
        place = folder / side
        journals[side] = (
            Journal.resume(place, header)
            if resume and Journal.begun(place)
            else Journal.create(place, header, spec_files(spec))
        )
    with Runner(executor or process_pool(2)) as runner:
        simulated: Experiment = Rollouts(
            rigs["sim"], seed, journals["sim"], runner, Stream.GAP_SIM, SIMULATED_PER_REAL
        )
        if sides.recorded is None:
            real = Rollouts(rigs["real"], seed, journals["real"], runner, Stream.GAP_REAL)
            drive(search, Pairs(simulated, real), observer)
        else:
            if sides.simulated is not None:
                simulated = Recorded(sides.simulated, rigs["sim"], journals["sim"], SIMULATED_PER_REAL)
            recorded = Recorded(sides.recorded, rigs["real"], journals["real"])
            observe(search, sides.recorded, Pairs(simulated, recorded, watched="simulated"), observer)
    tested, failures = _tested(journals)
    certificate = search.certificate()
    unit = rho_unit(spec, requirement)
    lowest, highest = search.range
    assumptions = (
        *(
            text.replace("the expected outcome", "the expected gap E Δ").replace("one rollout", "one Δ")
            for text in certificate.assumptions
        ),
        f"the real machine's ρ is R-sub-Gaussian with the spec's R, like the simulator's; each Δ is one real rollout "
        f"minus the mean of {SIMULATED_PER_REAL if sides.per_real > 1 else 'one or two'} simulated ones",
        f"a rollout that falls or crashes counts as ρ = {rigs['real'].fall:g} {unit}".rstrip()
        + " on both sides",
    )
    if sides.recorded is not None:
        assumptions += (*sides.notes, *left_open(search, "E Δ"))
    if sides.real.name.startswith("twin"):
        assumptions += (
            f"{sides.real.name} is a twin: a simulator that stands in for hardware, not hardware",
        )
    return GapResult(
        requirement=requirement,
        lower=-certificate.upper,
        upper=-certificate.lower,
        low=-highest,
        high=-lowest,
        unit=unit,
        worst=min(tested, key=lambda test: distance(spec, test.params, certificate.worst)),
        tested=tuple(tested),
        failures=failures,
        assumptions=assumptions,
        certificate=certificate,
        provenance=provenance,
        folder=folder,
        seconds=perf_counter() - start,
    )


def certify(
    spec: Spec,
    simulated: str,
    real: str,
    folder: Path,
    *,
    requirement: str | None = None,
    seed: int = 0,
    budget: int | None = None,
    mode: str = "rigorous",
    engine: str = "spectral",
    executor: ExecutorFactory | None = None,
    resume: bool = False,
    observer: Observer | None = None,
) -> CertifyResult:
    """Run both searches and compose them into a promise about the real machine; see :func:`gap`.

    ``budget`` bounds the real rollouts; the simulator runs as many as its ε takes. Search 2 does
    not begin when search 1 was refused: rollouts of the real machine could not mend that.
    """
    requirement = requirement or only_requirement(spec)
    sides = Sides.of(spec, requirement, simulated, real, budget)
    first = search_for(spec, requirement, seed=seed, budget=None, mode=mode, engine=engine)
    second = gap_search(
        spec, requirement, seed=seed, budget=budget, mode=mode, engine=engine, per_real=sides.per_real
    )
    checked = check_with(
        first, spec, requirement, simulated, folder / "simulation", seed, executor, resume, observer
    )
    if not checked.certificate.label.bounds:
        reason = f"no certificate for simulation: {checked.certificate.reason}; no rollout of {real} was run"
        return CertifyResult(Verdict.UNKNOWN, reason, real, checked, None, None)
    bounded = gap_with(second, spec, requirement, sides, folder / "gap", seed, executor, resume, observer)
    if not bounded.certificate.label.bounds:
        reason = f"no certificate for the gap: {bounded.certificate.reason}"
        return CertifyResult(Verdict.UNKNOWN, reason, real, checked, bounded, None)
    composition = compose(first, second)
    if composition.lower >= 0:
        verdict, reason = Verdict.HOLDS, f"the worst expected robustness of {real} is not negative"
    elif composition.upper < 0:
        verdict, reason = Verdict.VIOLATED, f"the worst expected robustness of {real} is negative"
    else:
        way = "more real rollouts" if bounded.certificate.label is Label.BUDGET else "a smaller epsilon"
        if sides.recorded is not None:
            where = ", ".join(f"{name} = {value:.4g}" for name, value in second.suggestion.items())
            way = f"a further recorded test, best at {where},"
        verdict, reason = Verdict.UNKNOWN, f"the interval contains 0; {way} may decide it"
    return CertifyResult(verdict, reason, real, checked, bounded, composition)


def _tested(journals: Mapping[str, Journal]) -> tuple[list[GapTested], dict[str, int]]:
    """Group pairs by test point, and count failures of the real side."""
    simulated: dict[tuple[int, int], list[float]] = {}
    for record in journals["sim"].records():
        key = record.query, record.replicate // SIMULATED_PER_REAL
        simulated.setdefault(key, []).append(record.rho)
    groups: dict[tuple[float, ...], list[float]] = {}
    names: list[str] = []
    failures: dict[str, int] = {}
    for record in journals["real"].records():
        names = list(record.params)
        delta = record.rho - float(np.mean(simulated[record.query, record.replicate]))
        groups.setdefault(tuple(record.params.values()), []).append(delta)
        if record.failure is not None:
            failures[record.failure] = failures.get(record.failure, 0) + 1
    tested = [
        GapTested(
            dict(zip(names, point, strict=True)),
            len(deltas),
            float(np.mean(deltas)),
            float(np.mean(np.abs(deltas))),
        )
        for point, deltas in groups.items()
    ]
    if not tested:
        raise UsageError("no pair of rollouts was run: the budget is smaller than the first batch")
    return tested, failures
