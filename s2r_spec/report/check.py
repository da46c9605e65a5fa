"""The result of ``s2r check`` as findings, and as one JSON object."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from s2r_spec.backend import short
from s2r_spec.base.json_types import Location
from s2r_spec.base.printable import spell_unit
from s2r_spec.base.verdict import Verdict, worst
from s2r_spec.certify.bound.certificate import Certificate, Label
from s2r_spec.certify.bound.rounding import at_least, at_most, down, interval_text, up, width_text
from s2r_spec.certify.check import CheckResult
from s2r_spec.certify.result.gap_result import GapResult
from s2r_spec.certify.result.voids import void_words
from s2r_spec.report.finding import Finding, Report
from s2r_spec.report.records.certificates import CheckObject
from s2r_spec.spec import Spec

Result = CheckResult | GapResult
"""The result of one search."""

ROOTS = (2, 3)
"""Level: an interval's width falls at best with the square root of the rollouts, as at one known test. Where many tests
are nearly the worst, it falls with about the cube root (docs/explanation/certificate.md)."""


def report(pairs: Sequence[tuple[Spec, CheckResult]], command: str = "s2r check") -> Report:
    """Return the report of several results, each with its spec; every reporter renders it."""
    code = worst(result.verdict for _, result in pairs).exit_code
    record = CheckObject(
        exit_code=code,
        results=tuple(result for _, result in pairs),
        locations={result.requirement: location(spec, result.requirement) for spec, result in pairs},
    )
    return Report(command, tuple(finding(*pair) for pair in pairs), code, record)


def finding(spec: Spec, result: CheckResult) -> Finding:
    """Return the finding of one requirement: its bound, facts and assumptions in words."""
    certificate, source = result.certificate, result.provenance
    unit = f" {result.unit}" if result.unit else ""
    probability, label = probability_words(certificate), str(certificate.label.value)
    if certificate.label is not Label.ONE_SIDED:
        label += (
            f"; interval {width_text(certificate.epsilon)} wide (target {certificate.target:g}), including "
            f"{at_most(certificate.discretisation, 2)} for the grid"
        )
    facts = (
        ("worst expected ρ", f"{interval_words(result)}, {probability}"),
        (
            "worst test",
            f"{test_words(result.worst.params, spec.space.units)}: mean ρ {result.worst.mean:+.4f}{unit} "
            f"over {result.worst.rollouts} rollouts, lowest {result.worst.lowest:+.4f}",
        ),
        *effort(result),
        ("label", label),
        *narrower(certificate),
    )
    return Finding(
        name=result.requirement,
        verdict=result.verdict,
        word=result.verdict.name,
        refused=certificate.label is Label.REFUSED,
        about=f"{source['spec']} on backend {source['backend']}",
        reason=result.reason,
        headline="no certificate"
        if certificate.label is Label.REFUSED
        else f"worst expected ρ {bound(result.verdict, result.lower, result.upper)}{unit}, {probability}",
        facts=facts,
        assumptions=result.assumptions,
        ladder=ladder(result, "ρ"),
        provenance=origin(source, f"model {short(source['model_hash'])}"),
        again=f"lowest ρ ({result.lowest.rho:+.4f}{unit})",
        replay=result.replay,
        location=location(spec, result.requirement),
        seconds=result.seconds,
    )


def test_words(params: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return a test with its units, in their order: ``vd = 0.3 m/s, slope = 2 deg``."""
    ordered = [*(name for name in units if name in params), *(name for name in params if name not in units)]
    spelled = {name: spell_unit(units.get(name, "")) for name in ordered}
    return ", ".join(f"{name} = {params[name]:.4g} {spelled[name]}".rstrip() for name in ordered)


def effort(result: Result, of: str = "") -> tuple[tuple[str, str], ...]:
    """Return the rows on the rollouts: number, falls, summed time, and void ones; ``of`` says of which machine."""
    certificate, seconds = result.certificate, result.seconds
    failures = ", ".join(f"{count} × {word}" for word, count in sorted(result.failures.items())) or "no falls"
    # Recordings were not run.
    took = f", {seconds:.{0 if seconds >= 10 else 1}f} s of rollouts (wall time)" if seconds else ""
    rows = (
        ("effort", f"{certificate.rollouts} rollouts{of} at {certificate.points} tests, {failures}{took}"),
    )
    return rows if result.voids is None else (*rows, ("void", void_words(result.voids, certificate.rollouts)))


def narrower(certificate: Certificate) -> tuple[tuple[str, str], ...]:
    """Return the row on the widths that more rollouts would reach, of a search that its verdict ended."""
    if certificate.label is not Label.DECIDED:
        return ()
    twice, four = (
        " to ".join(f"{certificate.epsilon / factor ** (1 / root):.2g}" for root in ROOTS)
        for factor in (2, 4)
    )
    words = f"with 2 × the rollouts the interval would be about {twice} wide, with 4 × about {four}"
    return (("--stop epsilon", words),)


def interval_words(result: Result) -> str:
    """Return the interval with its unit; only the upper end if no other is certified."""
    unit = f" {result.unit}" if result.unit else ""
    if result.certificate.label is Label.ONE_SIDED:
        return f"≤ {up(result.upper)}{unit}"
    return f"in {interval_text(result.lower, result.upper)}{unit}"


def probability_words(certificate: Certificate) -> str:
    """Return the probability of a bound in words."""
    if not certificate.label.certifies:
        return "not certified"
    return f"with probability ≥ 1 − {certificate.delta:g}"


def bound(verdict: Verdict, lower: float, upper: float) -> str:
    """Return the end of an interval that decides a verdict, ``≥ +0.0041``; both ends if none does."""
    match verdict:
        case Verdict.HOLDS:
            return f"≥ {down(lower)}"
        case Verdict.VIOLATED:
            return f"≤ {up(upper)}"
        case Verdict.UNKNOWN:
            return f"in {interval_text(lower, upper)}"


def origin(source: Mapping[str, Any], models: str) -> str:
    """Return the seed, the version and the hashes of a run in one line."""
    return f"seed {source['seed']}, s2r {source['s2r']}, spec {source['spec_hash'][:12]}, {models}"


def ladder(result: Result, symbol: str) -> tuple[str, ...]:
    """Return the interval for each norm bound B, 2B, 4B and 8B, the refuted norm bounds, and the e-value against R."""
    unit = f" {result.unit}" if result.unit else ""
    return (
        *(
            f"if B = {rung.B:g}{unit}: {symbol} in {interval_text(-rung.upper, -rung.lower)}{unit}"
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


def location(spec: Spec, requirement: str) -> Location:
    """Return the file and line of a requirement."""
    return Location(file=spec.name, line=spec.formulas[requirement].span.line)
