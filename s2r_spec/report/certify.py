"""The result of ``s2r certify`` as a finding, and as one JSON object."""

from __future__ import annotations

from collections.abc import Sequence

from s2r_spec.backend import short
from s2r_spec.certify.bound.rounding import down, interval_text
from s2r_spec.certify.real_machine import CertifyResult
from s2r_spec.certify.result.check_result import CheckResult
from s2r_spec.certify.result.gap_result import GapResult
from s2r_spec.report import check as check_report
from s2r_spec.report import gap as gap_report
from s2r_spec.report.finding import Finding, Report
from s2r_spec.report.recompute import Certified
from s2r_spec.report.records.certificates import CertifyObject
from s2r_spec.spec import Spec


def report(spec: Spec, result: CertifyResult, command: str = "s2r certify") -> Report:
    """Return the report of both searches; every reporter renders it."""
    code, one = result.verdict.exit_code, finding(spec, result)
    record = CertifyObject(exit_code=code, result=result, location=one.location)
    return Report(command, (one,), code, record)


def report_of(results: Sequence[Certified], *command: str) -> Report:
    """Return the report of results of one kind, as of the command that makes such results, or of ``command``."""
    first = results[0]
    if isinstance(first, GapResult):
        return gap_report.report(first.spec, first, *command)
    if isinstance(first, CertifyResult):
        return report(first.simulated.spec, first, *command)
    checks = [result for result in results if isinstance(result, CheckResult)]
    return check_report.report([(result.spec, result) for result in checks], *command)


def finding(spec: Spec, result: CertifyResult) -> Finding:
    """Return the bound for the real machine in words, with both of its parts."""
    simulated, gap = result.simulated, result.gap
    source, composed = simulated.provenance, result.composition
    model = f"{source['backend']} {short(source['model_hash'])}"
    if gap is not None:
        model += f", {result.real} {short(gap.provenance['real']['model_hash'])}"
    unit = f" {simulated.unit}" if simulated.unit else ""
    headline = f"no bound for {result.real}"
    if composed is not None:
        bound = check_report.bound(result.verdict, composed.lower, composed.upper)
        probability = f"with probability ≥ 1 − {composed.delta:g}"
        headline = f"worst expected ρ of {result.real} {bound}{unit}, {probability}"
    # The simulation's last assumption says that it does not cover the real machine; the gap covers it here.
    assumptions = (*simulated.assumptions[:-1], *(gap.assumptions if gap else ()))
    return Finding(
        name=simulated.requirement,
        verdict=result.verdict,
        word=result.verdict.name,
        refused=composed is None,
        about=f"{source['spec']}: {source['backend']} against {result.real}",
        reason=result.reason,
        headline=headline,
        facts=_facts(spec, result),
        assumptions=tuple(dict.fromkeys(assumptions)),
        ladder=_ladder(result),
        provenance=check_report.origin(source, model),
        again=(
            f"real rollout of the lowest Δ ({gap.lowest.gap:+.4f}{unit})"
            if gap
            else f"lowest ρ ({simulated.lowest.rho:+.4f}{unit})"
        ),
        replay=gap.replay if gap else simulated.replay,
        location=check_report.location(spec, simulated.requirement),
        seconds=simulated.seconds + (gap.seconds if gap else 0.0),
    )


def _facts(spec: Spec, result: CertifyResult) -> tuple[tuple[str, str], ...]:
    simulated, gap, composed = result.simulated, result.gap, result.composition
    unit = f" {simulated.unit}" if simulated.unit else ""
    bound: tuple[tuple[str, str], ...] = (("worst expected ρ", "no bound for the real machine"),)
    if composed is not None:
        bound = (
            (
                "worst expected ρ",
                f"in {interval_text(composed.lower, composed.upper)}{unit} for {result.real}, "
                f"with probability ≥ 1 − {composed.delta:g}",
            ),
            ("worst test", check_report.test_words(composed.worst, spec.space.units)),
            (
                "the paper's sum",
                f"≥ {down(composed.paper_lower)}{unit} (the worst cases of both searches, added)",
            ),
        )
    return (
        *bound,
        (
            "in simulation",
            f"worst expected ρ {check_report.interval_words(simulated)}, "
            f"{simulated.certificate.rollouts} rollouts, {simulated.certificate.label.value}",
        ),
        *(gap_report.facts(gap, spec.space.units) if gap else (("gap", "not searched"),)),
    )


def _ladder(result: CertifyResult) -> tuple[str, ...]:
    simulated, gap = result.simulated, result.gap
    unit = f" {simulated.unit}" if simulated.unit else ""
    rows = [f"in simulation, {row}" for row in check_report.ladder(simulated, "ρ")]
    if gap is None:
        return tuple(rows)
    rows += [f"the gap, {row}" for row in check_report.ladder(gap, "Δ")]
    if result.composition is not None:
        rows += [
            f"the paper's sum, if B = {of_sim.B:g}{unit}: ρ ≥ {down(-of_sim.upper - of_gap.upper)}{unit}"
            for of_sim, of_gap in zip(simulated.certificate.ladder, gap.certificate.ladder, strict=True)
        ]
    return tuple(rows)
