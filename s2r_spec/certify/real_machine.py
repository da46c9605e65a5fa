"""Both searches, and what they promise of the real machine together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from s2r_spec.backend import Operator
from s2r_spec.certify.arguments import as_folder, as_name, as_spec, require_begun
from s2r_spec.certify.certificate import Label
from s2r_spec.certify.check import CheckResult, Verdict, check_with, only_requirement, search_for
from s2r_spec.certify.compose import Composition, compose
from s2r_spec.certify.experiments import Observer
from s2r_spec.certify.gap import GapResult, gap_search, gap_with
from s2r_spec.certify.pairing import Pairing
from s2r_spec.certify.search import Search
from s2r_spec.rollouts.attendance import refuse_terms, terms_of
from s2r_spec.rollouts.layout import GAP, SIMULATION
from s2r_spec.rollouts.machine_journal import AGAIN
from s2r_spec.rollouts.pools import ExecutorFactory
from s2r_spec.spec import Spec


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


def certify(
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
) -> CertifyResult:
    """Run both searches and compose them into a promise about the real machine; see :func:`gap`.

    ``budget`` bounds the real rollouts; the simulator runs as many as its ε takes. Search 2 does
    not begin when search 1 was refused: rollouts of the real machine could not mend that.
    """
    spec, folder = as_spec(spec), as_folder(folder)
    simulated, real = as_name(simulated, "simulated"), as_name(real, "real")
    requirement = requirement or only_requirement(spec)
    if resume:
        require_begun([folder / SIMULATION], folder)
    pairing, terms = Pairing.for_spec(spec, requirement, simulated, real, budget), terms_of(void, operator)
    refuse_terms(pairing.real.backend, terms)
    first = search_for(spec, requirement, seed=seed, budget=None, mode=mode, engine=engine)
    second = gap_search(
        spec, requirement, seed=seed, budget=budget, mode=mode, engine=engine, per_real=pairing.per_real
    )
    if pairing.recorded is None:
        second.refuse_hopeless()
    checked = check_with(
        first, spec, requirement, simulated, folder / SIMULATION, seed, executor, timeout, resume, observer
    )
    if not checked.certificate.label.bounds:
        return refused_in_simulation(checked, real)
    bounded = gap_with(
        second, spec, requirement, pairing, folder / GAP, seed, executor, timeout, resume, observer, terms
    )
    return conclude_certify(first, second, checked, bounded)


def refused_in_simulation(checked: CheckResult, real: str) -> CertifyResult:
    """Return what there is when search 1 has no certificate."""
    reason = f"no certificate for simulation: {checked.certificate.reason}; no rollout of {real} was run"
    return CertifyResult(Verdict.UNKNOWN, reason, real, checked, None, None)


def conclude_certify(
    first: Search, second: Search, checked: CheckResult, bounded: GapResult
) -> CertifyResult:
    """Return what two searches promise of the real machine, whose results are these."""
    real = bounded.provenance["real"]["backend"]
    for name, certificate in (("simulation", checked.certificate), ("the gap", bounded.certificate)):
        if not certificate.label.bounds:
            reason = f"no certificate for {name}: {certificate.reason}"
            return CertifyResult(Verdict.UNKNOWN, reason, real, checked, bounded, None)
    composition = compose(first, second)
    if composition.lower >= 0:
        verdict, reason = Verdict.HOLDS, f"the worst expected robustness of {real} is not negative"
    elif composition.upper < 0:
        verdict, reason = Verdict.VIOLATED, f"the worst expected robustness of {real} is negative"
    else:
        way = "more real rollouts" if bounded.certificate.label is Label.BUDGET else "a smaller epsilon"
        if "recorded" in bounded.provenance:
            where = ", ".join(f"{name} = {value:.4g}" for name, value in second.suggestion.items())
            way = f"a further recorded test, best at {where},"
        verdict, reason = Verdict.UNKNOWN, f"the interval contains 0; {way} may decide it"
    return CertifyResult(verdict, reason, real, checked, bounded, composition)
