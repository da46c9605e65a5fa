"""The result of ``s2r check`` as findings, and as one JSON object."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

from s2r_spec.backend import short
from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.check import CheckResult, Verdict
from s2r_spec.certify.rounding import at_least, at_most, between, down, up, wide
from s2r_spec.certify.voids import void_words
from s2r_spec.json_objects.check import (
    CheckedRequirement,
    CheckObject,
    Provenance,
    RobustnessSearch,
    WorstExpectedRobustness,
)
from s2r_spec.json_objects.parts import Location, extended
from s2r_spec.report.finding import Finding, Report, Section
from s2r_spec.spec import Spec

LARGER_B = "Interval for larger B (all rows hold at once)"
"""Title of the section that gives the bound for B, 2B, 4B and 8B."""


def report(pairs: Sequence[tuple[Spec, CheckResult]], command: str = "s2r check") -> Report:
    """Return the report of several results, each with its spec; every reporter renders it."""
    # Worst first, as the exit codes are ranked: 1 > 3 > 0.
    code = max((result.verdict.exit_code for _, result in pairs), key=[0, 3, 1].index)
    record = CheckObject(
        exit_code=code,
        results=tuple(requirement_record(result) for _, result in pairs),
        locations={result.requirement: location(spec, result.requirement) for spec, result in pairs},
    )
    return Report(command, tuple(finding(*pair) for pair in pairs), code, record)


def requirement_record(result: CheckResult) -> CheckedRequirement:
    """Return the record of one requirement."""
    certificate = result.certificate
    return CheckedRequirement(
        requirement=result.requirement,
        verdict=result.verdict,
        reason=result.reason,
        worst_expected_robustness=WorstExpectedRobustness(
            lower=result.lower,
            upper=result.upper,
            unit=result.unit,
            epsilon=certificate.epsilon,
            probability_at_least=1 - certificate.delta,
            delta=certificate.delta,
        ),
        label=certificate.label,
        worst=result.worst,
        lowest=result.lowest,
        failures=result.failures,
        assumptions=result.assumptions,
        search=extended(RobustnessSearch, certificate),
        provenance=cast(Provenance, result.provenance),
        folder=str(result.folder),
        replay=replay_line(result),
        seconds=round(result.seconds, 3),
        voids=result.voids,
    )


def voids_fact(voids: Mapping[str, int] | None, rollouts: int) -> tuple[tuple[str, str], ...]:
    """Return the row of void rollouts, which only a machine has; ``rollouts`` counts those with an outcome."""
    return () if voids is None else (("void", void_words(voids, rollouts)),)


def finding(spec: Spec, result: CheckResult) -> Finding:
    """Return the finding of one requirement: its bound, facts and assumptions in words."""
    certificate, source = result.certificate, result.provenance
    unit = f" {result.unit}" if result.unit else ""
    failures = ", ".join(f"{count} × {word}" for word, count in sorted(result.failures.items())) or "no falls"
    probability = probability_words(certificate)
    facts = (
        ("worst expected ρ", f"in {between(result.lower, result.upper)}{unit}, {probability}"),
        (
            "worst test",
            f"{test_words(result.worst.params, spec.space.units)}: mean ρ {result.worst.mean:+.4f}{unit} "
            f"over {result.worst.rollouts} rollouts, lowest {result.worst.lowest:+.4f}",
        ),
        (
            "effort",
            f"{certificate.rollouts} rollouts at {certificate.points} tests, {failures}"
            f"{took(result.seconds)}",
        ),
        *voids_fact(result.voids, certificate.rollouts),
        (
            "label",
            f"{certificate.label.value}; interval {wide(certificate.epsilon)} wide "
            f"(target {certificate.target:g}), including {at_most(certificate.discretisation, 2)} for the grid",
        ),
    )
    return Finding(
        name=result.requirement,
        verdict=result.verdict,
        word=result.verdict.name,
        refused=certificate.label is Label.REFUSED,
        about=f"{source['spec']} on backend {source['backend']}",
        reason=result.reason,
        headline=_headline(result, unit, probability),
        facts=facts,
        sections=(
            Section("This assumes", result.assumptions),
            Section(LARGER_B, ladder(result)),
        ),
        provenance=(
            f"seed {source['seed']}, s2r {source['s2r']}, spec {source['spec_hash'][:12]}, "
            f"model {short(source['model_hash'])}"
        ),
        again=f"lowest ρ ({result.lowest.rho:+.4f}{unit})",
        replay=replay_line(result),
        file=Path(spec.name),
        line=location(spec, result.requirement).line,
        seconds=result.seconds,
    )


def test_words(params: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return a test with its units, in their order: ``vd = 0.3 m/s, slope = 2 deg``."""
    ordered = [*(name for name in units if name in params), *(name for name in params if name not in units)]
    return ", ".join(f"{name} = {params[name]:.4g} {units.get(name, '')}".rstrip() for name in ordered)


def took(seconds: float) -> str:
    """Return the time of all rollouts, summed over the workers; "" for recordings, which were not run."""
    return f", {seconds:.{0 if seconds >= 10 else 1}f} s of rollouts" if seconds else ""


def probability_words(certificate: Certificate) -> str:
    """Return the probability of a bound in words."""
    if not certificate.label.bounds:
        return "not certified"
    return f"with probability ≥ 1 − {certificate.delta:g}"


def ladder(result: CheckResult) -> tuple[str, ...]:
    """Return the interval for each norm bound B, 2B, 4B and 8B, the refuted norm bounds, and the e-value against R."""
    unit = f" {result.unit}" if result.unit else ""
    return (
        *(
            f"if B = {rung.B:g}{unit}: ρ in {between(-rung.upper, -rung.lower)}{unit}"
            for rung in result.certificate.ladder
        ),
        refuted_words(result.certificate, result.unit),
    )


def refuted_words(certificate: Certificate, unit: str) -> str:
    """Return the norm bounds that the data refute, and the e-value against R."""
    e_value = math.exp(min(certificate.log_e_value, 700.0))
    return (
        f"the data refute every B < {at_least(certificate.B_low)} {unit}".rstrip()
        + f"; the e-value against R is {e_value:.3g} (1/δ refutes R)"
    )


def replay_line(result: CheckResult) -> str:
    """Return the shell command that runs the rollout of the lowest ρ again."""
    return f"s2r replay {shlex.quote(str(result.folder))}#{result.lowest.query}.{result.lowest.replicate}"


def _headline(result: CheckResult, unit: str, probability: str) -> str:
    if result.certificate.label is Label.REFUSED:
        return "no certificate"
    if result.verdict is Verdict.HOLDS:
        return f"worst expected ρ ≥ {down(result.lower)}{unit}, {probability}"
    if result.verdict is Verdict.VIOLATED:
        return f"worst expected ρ ≤ {up(result.upper)}{unit}, {probability}"
    return f"worst expected ρ in {between(result.lower, result.upper)}{unit}, {probability}"


def location(spec: Spec, requirement: str) -> Location:
    """Return the file and line of a requirement."""
    return Location(file=spec.name, line=spec.formulas[requirement].span.line)
