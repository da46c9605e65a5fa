"""The result of ``s2r gap`` as a finding, and as one JSON object."""

from __future__ import annotations

from collections.abc import Mapping

from s2r_spec.backend import short
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.rounding import down, interval_text
from s2r_spec.certify.result.gap_result import GapResult
from s2r_spec.report.check import effort, ladder, location, origin, probability_words, test_words
from s2r_spec.report.finding import Finding, Report
from s2r_spec.report.records.certificates import GapObject
from s2r_spec.runs.layout import SYSTEMS
from s2r_spec.spec import Spec


def report(spec: Spec, result: GapResult, command: str = "s2r gap") -> Report:
    """Return the report of a gap; every reporter renders it."""
    one = finding(spec, result)
    code = one.verdict.exit_code
    record = GapObject(exit_code=code, result=result, location=one.location)
    return Report(command, (one,), code, record)


def finding(spec: Spec, result: GapResult) -> Finding:
    """Return the finding of a gap: its bound, facts and assumptions in words."""
    certificate, source = result.certificate, result.provenance
    unit = f" {result.unit}" if result.unit else ""
    bound = f"worst expected Δ ≥ {down(result.lower)}{unit}, {probability_words(certificate)}"
    verdict, word, reason = _judge(result)
    return Finding(
        name=result.requirement,
        verdict=verdict,
        word=word,
        refused=certificate.label is Label.REFUSED,
        about=f"{source['spec']}: {source['sim']['backend']} against {source['real']['backend']}",
        reason=reason,
        headline=bound if certificate.label.bounds else "no bound",
        facts=facts(result, spec.space.units),
        assumptions=result.assumptions,
        ladder=ladder(result, "Δ"),
        provenance=origin(source, ", ".join(f"{one} {short(source[one]['model_hash'])}" for one in SYSTEMS)),
        again=f"real rollout of the lowest Δ ({result.lowest.gap:+.4f}{unit})",
        replay=result.replay,
        location=location(spec, result.requirement),
        seconds=result.seconds,
    )


def facts(result: GapResult, units: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """Return the (name, text) rows of a gap."""
    unit = f" {result.unit}" if result.unit else ""
    certificate = result.certificate
    reason = f" ({certificate.reason})" if certificate.reason else ""
    certain = f", {probability_words(certificate)}; anywhere in {interval_text(result.low, result.high)}"
    computed = "" if certificate.label.bounds else " (not certified)"
    return (
        ("worst expected Δ", f"in {interval_text(result.lower, result.upper)}{unit}{computed or certain}"),
        (
            "worst gap at",
            f"{test_words(result.worst.params, units)}: mean Δ {result.worst.mean:+.4f}{unit}, "
            f"mean |Δ| {result.worst.absolute:.4f} over {result.worst.pairs} pairs",
        ),
        (
            "largest mean |Δ|",
            f"{result.absolute:.4f}{unit} at a tested point (the paper's measure; an estimate)",
        ),
        *effort(result, f" of {result.provenance['real']['backend']}"),
        ("label", f"{certificate.label.value}{reason}"),
    )


def _judge(result: GapResult) -> tuple[Verdict, str, str]:
    """Return verdict, word and reason. A gap neither holds nor fails: its interval is at most ε wide, or wider."""
    certificate = result.certificate
    if not certificate.label.bounds:
        return Verdict.UNKNOWN, "NO BOUND", f"no certificate: {certificate.reason}"
    if certificate.label is Label.CERTIFIED:
        return Verdict.HOLDS, "BOUNDED", "the interval of the gap is at most ε wide"
    more = f"more rollouts of {result.provenance['real']['backend']} would narrow the interval"
    return Verdict.UNKNOWN, "BOUNDED, wider than ε", f"the interval is valid, but wider than ε; {more}"
