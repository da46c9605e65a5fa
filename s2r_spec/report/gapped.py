"""The result of ``s2r gap`` as a finding, and as one JSON object."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import cast

from s2r_spec.backend import short
from s2r_spec.certify.certificate import Label
from s2r_spec.certify.check import Verdict
from s2r_spec.certify.gap_result import GapResult
from s2r_spec.certify.rounding import between, down
from s2r_spec.json_objects.gap import Band, BoundedGap, GapObject, GapProvenance, GapSearch, WorstExpectedGap
from s2r_spec.json_objects.parts import extended
from s2r_spec.report.checked import (
    LARGER_B,
    location,
    probability_words,
    refuted_words,
    test_words,
    took,
    voids_fact,
)
from s2r_spec.report.finding import Finding, Report, Section
from s2r_spec.spec import Spec

# A gap has no verdict of its own: its interval is at most ε wide, or wider.
WORDS = {
    Label.CERTIFIED: "BOUNDED",
    Label.BUDGET: "BOUNDED, wider than ε",
    Label.RUNNING: "BOUNDED, wider than ε",
    Label.REFUSED: "NO BOUND",
    Label.MODEL_BASED: "NO BOUND",
}


def report(spec: Spec, result: GapResult, command: str = "s2r gap") -> Report:
    """Return the report of a gap; every reporter renders it."""
    one = finding(spec, result)
    code, where = one.verdict.exit_code, location(spec, result.requirement)
    record = extended(GapObject, gap_record(result), exit_code=code, location=where)
    return Report(command, (one,), code, record)


def gap_record(result: GapResult) -> BoundedGap:
    """Return the record of a gap."""
    certificate = result.certificate
    return BoundedGap(
        requirement=result.requirement,
        worst_expected_gap=WorstExpectedGap(
            lower=result.lower,
            upper=result.upper,
            unit=result.unit,
            epsilon=certificate.epsilon,
            delta=certificate.delta if certificate.label.bounds else None,
        ),
        band=Band(low=result.low, high=result.high, unit=result.unit),
        label=certificate.label,
        reason=certificate.reason,
        worst=result.worst,
        lowest=result.lowest,
        largest_mean_absolute_gap=result.absolute,
        failures=result.failures,
        assumptions=result.assumptions,
        tested=result.tested,
        search=extended(GapSearch, certificate),
        provenance=cast(GapProvenance, result.provenance),
        folder=str(result.folder),
        replay=replay_line(result),
        seconds=round(result.seconds, 3),
        voids=result.voids,
    )


def finding(spec: Spec, result: GapResult) -> Finding:
    """Return the finding of a gap: its bound, facts and assumptions in words."""
    certificate, source = result.certificate, result.provenance
    unit = f" {result.unit}" if result.unit else ""
    bound = f"worst expected Δ ≥ {down(result.lower)}{unit}, {probability_words(certificate)}"
    return Finding(
        name=result.requirement,
        verdict=Verdict.HOLDS if certificate.label is Label.CERTIFIED else Verdict.UNKNOWN,
        word=WORDS[certificate.label],
        refused=certificate.label is Label.REFUSED,
        about=about(result),
        reason=_reason(result),
        headline=bound if certificate.label.bounds else "no bound",
        facts=facts(result, spec.space.units),
        sections=(
            Section("This assumes", result.assumptions),
            Section(LARGER_B, ladder(result)),
        ),
        provenance=(
            f"seed {source['seed']}, s2r {source['s2r']}, spec {source['spec_hash'][:12]}, "
            f"sim {short(source['sim']['model_hash'])}, real {short(source['real']['model_hash'])}"
        ),
        again=f"real rollout of the lowest Δ ({result.lowest.gap:+.4f}{unit})",
        replay=replay_line(result),
        file=Path(spec.name),
        line=location(spec, result.requirement).line,
        seconds=result.seconds,
    )


def about(result: GapResult) -> str:
    """Return the compared systems: ``a1_velocity.stl: sim against twin:lab``."""
    source = result.provenance
    return f"{source['spec']}: {source['sim']['backend']} against {source['real']['backend']}"


def facts(result: GapResult, units: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """Return the (name, text) rows of a gap."""
    unit = f" {result.unit}" if result.unit else ""
    certificate = result.certificate
    failures = ", ".join(f"{count} × {word}" for word, count in sorted(result.failures.items())) or "no falls"
    reason = f" ({certificate.reason})" if certificate.reason else ""
    certain = f", {probability_words(certificate)}; anywhere in {between(result.low, result.high)}"
    computed = "" if certificate.label.bounds else " (not certified)"
    return (
        ("worst expected Δ", f"in {between(result.lower, result.upper)}{unit}{computed or certain}"),
        (
            "worst gap at",
            f"{test_words(result.worst.params, units)}: mean Δ {result.worst.mean:+.4f}{unit}, "
            f"mean |Δ| {result.worst.absolute:.4f} over {result.worst.pairs} pairs",
        ),
        (
            "largest mean |Δ|",
            f"{result.absolute:.4f}{unit} at a tested point (the paper's measure; an estimate)",
        ),
        (
            "effort",
            f"{certificate.rollouts} rollouts of {result.provenance['real']['backend']} at "
            f"{certificate.points} tests, {failures}{took(result.seconds)}",
        ),
        *voids_fact(result.voids, certificate.rollouts),
        (
            "label",
            f"{certificate.label.value}{reason}",
        ),
    )


def ladder(result: GapResult) -> tuple[str, ...]:
    """Return the interval of the gap for each norm bound B, 2B, 4B and 8B, and what the data refute."""
    unit = f" {result.unit}" if result.unit else ""
    return (
        *(
            f"if B = {rung.B:g}{unit}: Δ in {between(-rung.upper, -rung.lower)}{unit}"
            for rung in result.certificate.ladder
        ),
        refuted_words(result.certificate, result.unit),
    )


def replay_line(result: GapResult) -> str:
    """Return the command that runs the real rollout of the lowest Δ again."""
    return f"s2r replay {shlex.quote(str(result.folder / 'real'))}#{result.lowest.query}.{result.lowest.replicate}"


def _reason(result: GapResult) -> str:
    certificate = result.certificate
    if not certificate.label.bounds:
        return f"no certificate: {certificate.reason}"
    if certificate.label is Label.CERTIFIED:
        return "the interval of the gap is at most ε wide"
    real = result.provenance["real"]["backend"]
    return f"the interval is valid, but wider than ε; more rollouts of {real} would narrow the interval"
