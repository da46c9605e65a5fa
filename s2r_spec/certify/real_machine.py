"""Search 1 and search 2, and their combined certificate of the real machine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

from s2r_spec.backend import Backend
from s2r_spec.base.json_values import Shown
from s2r_spec.base.result import Result
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.arguments import as_backend, as_spec, name_of, options_from
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.check import check_with
from s2r_spec.certify.from_spec import only_requirement, search_for
from s2r_spec.certify.gap import gap_search, gap_with
from s2r_spec.certify.options import (
    RunKeywords,
    RunOptions,
    refuse_rule,
    require_begun,
    run_folder,
    with_rule,
    with_seed,
)
from s2r_spec.certify.result.check_result import CheckResult, when_decided
from s2r_spec.certify.result.compose import Composition, compose, decides, judge
from s2r_spec.certify.result.gap_result import GapResult
from s2r_spec.certify.search.pairing import Pairing
from s2r_spec.certify.search.search import Search
from s2r_spec.machine.attendance import refuse_terms
from s2r_spec.runs.layout import GAP, SIMULATION, SYSTEMS
from s2r_spec.runs.machine_journal import AGAIN
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.stop_rule import BUDGET, EPSILON, stop_of
from s2r_spec.spec import Spec


@dataclass(frozen=True, repr=False)
class CertifyResult(Result, Shown):
    """Both searches, and the certificate of the real machine that follows from them.

    Attributes:
        verdict: holds, violated or unknown.
        reason: one sentence for the verdict.
        real: the backend of the real machine, which the bounds cover.
        simulated: result of search 1.
        simulation: the check of the simulator.
        gap: the gap between the two; None if the simulation was refused.
        composition: the combined interval; None if one of the searches has no certificate.
        promise: the bounds on the worst expected robustness of the real machine; None if there are none.
    """

    verdict: Verdict
    reason: str
    real: str
    simulated: CheckResult
    gap: GapResult | None
    composition: Composition | None

    JSON = "verdict reason real promise=composition simulation=simulated gap"


def certify(
    spec: Spec | Path | str,
    sim: Backend | str,
    real: Backend | str,
    folder: Path | str | None = None,
    **keywords: Unpack[RunKeywords],
) -> CertifyResult:
    """Run both searches and combine them; for the arguments see :func:`s2r_spec.certify.gap.gap`.

    ``budget`` bounds the real rollouts and ``stop`` ends them; the simulator runs as many as its ε takes. With
    ``stop="decided"`` search 2 ends as soon as the combined interval is ≥ 0 or < 0. Search 2 does not begin when
    search 1 was refused: rollouts of the real machine could not change that.

    Raises:
        UsageError: spec, backends and folder do not fit together, or there is no run to resume.
        BackendError: a rollout raised; every rollout before it is in the journals.
    """
    options = options_from(RunOptions, keywords)
    spec = as_spec(spec)
    sim, real = as_backend(sim, "sim"), as_backend(real, "real")
    requirement = options.requirement or only_requirement(spec)
    name = f"certify-{Path(spec.name).stem}-{name_of(sim)}-{name_of(real)}"
    with run_folder(folder, name, options) as run:
        if options.resume:
            require_begun([run / SIMULATION], run)
        places = [run / GAP / side for side in SYSTEMS]
        options = with_seed(with_rule(options, *places), run / SIMULATION, *places)
        pairing = Pairing.for_spec(spec, requirement, sim, real, options.budget)
        refuse_terms(pairing.real.backend, options.terms)
        of_simulator = replace(options, budget=None, stop=EPSILON, repeats=False, void=AGAIN, operator=None)
        first = search_for(spec, requirement, of_simulator)
        second = gap_search(spec, requirement, options, pairing.per_real)
        if pairing.recorded is None:
            second.refuse_hopeless()
        else:
            refuse_rule(second.settings.stop, pairing.real.name)
        second.end_when(lambda: decides(first, second))
        scorer = Scorer.for_spec(spec, requirement, sim)
        checked = check_with(first, spec, requirement, scorer, run / SIMULATION, of_simulator)
        if not checked.certificate.label.bounds:
            return refused_in_simulation(checked, pairing.real.name)
        bounded = gap_with(second, spec, requirement, pairing, run / GAP, options)
        return conclude_certify(first, second, checked, bounded)


def refused_in_simulation(checked: CheckResult, real: str) -> CertifyResult:
    """Return the result when search 1 has no certificate."""
    reason = f"no certificate for simulation: {checked.certificate.reason}; no rollout of {real} was run"
    return CertifyResult(Verdict.UNKNOWN, reason, real, checked, None, None)


def conclude_certify(
    first: Search, second: Search, checked: CheckResult, bounded: GapResult
) -> CertifyResult:
    """Return the certificate of the real machine from search 1, search 2 over the gap, and the results of both."""
    real = bounded.provenance["real"]["backend"]
    for name, certificate in (("simulation", checked.certificate), ("the gap", bounded.certificate)):
        if not certificate.label.bounds:
            reason = f"no certificate for {name}: {certificate.reason}"
            return CertifyResult(Verdict.UNKNOWN, reason, real, checked, bounded, None)
    composition = compose(first, second)
    verdict = judge(composition)
    if verdict is not Verdict.UNKNOWN:
        sign = "not negative" if verdict is Verdict.HOLDS else "negative"
        reason = f"the worst expected robustness of {real} is {sign}{when_decided(bounded.certificate.label)}"
    else:
        spent = bounded.certificate.label is Label.BUDGET or stop_of(bounded.provenance) == BUDGET
        way = "more real rollouts" if spent else "a smaller epsilon"
        if "recorded" in bounded.provenance:
            where = ", ".join(f"{name} = {value:.4g}" for name, value in second.suggestion.items())
            way = f"another recorded test, best at {where},"
        reason = f"the interval contains 0; {way} may decide it"
    return CertifyResult(verdict, reason, real, checked, bounded, composition)
