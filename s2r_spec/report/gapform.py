"""The gap, and the promise about the real machine, as text and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from rich.markup import escape

from s2r_spec.certify.certificate import Label
from s2r_spec.certify.gap import CertifyResult, GapResult
from s2r_spec.certify.outward import between, down
from s2r_spec.report.checked import test_words
from s2r_spec.report.checked import to_json as check_json
from s2r_spec.report.text import COLOURS


def gap_json(result: GapResult) -> dict[str, Any]:
    """Return the gap as one JSON object."""
    return {
        "schema": "s2r.gap/1",
        "requirement": result.requirement,
        "worst_expected_gap": {
            "lower": result.lower,
            "upper": result.upper,
            "unit": result.unit,
            "epsilon": result.certificate.epsilon,
            "delta": None if result.certificate.label is Label.REFUSED else result.certificate.delta,
        },
        "band": {"low": result.low, "high": result.high, "unit": result.unit},
        "label": result.certificate.label.value,
        "reason": result.certificate.reason,
        "worst": asdict(result.worst),
        "largest_mean_absolute_gap": result.absolute,
        "failures": result.failures,
        "assumptions": list(result.assumptions),
        "tested": [asdict(test) for test in result.tested],
        "search": {"objective": "-delta"} | result.certificate.to_json(),
        "provenance": result.provenance,
        "folder": str(result.folder),
        "seconds": round(result.seconds, 3),
    }


def certify_json(result: CertifyResult) -> dict[str, Any]:
    """Return both searches and the promise as one JSON object."""
    return {
        "schema": "s2r.certify/1",
        "exit_code": result.verdict.exit_code,
        "verdict": result.verdict.value,
        "reason": result.reason,
        "promise": asdict(result.composition) if result.composition else None,
        "simulation": check_json(result.simulated),
        "gap": gap_json(result.gap) if result.gap else None,
    }


def gap_text(result: GapResult, units: Mapping[str, str]) -> str:
    """Return rich markup for the gap."""
    return escape(
        "\n".join([_headline(result), *_gap_lines(result, units), *_assumptions(result.assumptions)])
    )


def certify_text(result: CertifyResult, units: Mapping[str, str]) -> str:
    """Return rich markup for the promise, with what it is made of."""
    simulated, gap, promise = result.simulated, result.gap, result.composition
    unit = f" {simulated.unit}" if simulated.unit else ""
    source = simulated.provenance
    sides = f"({source['spec']}: {source['backend']} against {result.real})"
    head = (
        f"{escape(simulated.requirement)}  [{COLOURS[result.verdict]}]{result.verdict.name}[/]  "
        f"{escape(sides)}"
    )
    bound = ["  nothing is promised of the real machine"]
    if promise is not None:
        bound = [
            f"  worst expected ρ  in {between(promise.lower, promise.upper)}{unit} for {result.real}, "
            f"with probability ≥ 1 − {promise.delta:g}",
            f"  worst test        {test_words(promise.worst, units)}",
            f"  as the paper adds ≥ {down(promise.paper_lower)}{unit} (worst case of each search, wherever it is)",
        ]
    lines = [
        f"  {result.reason}",
        "",
        *bound,
        "",
        f"  in simulation     worst expected ρ in {between(simulated.lower, simulated.upper)}{unit}, "
        f"{simulated.certificate.rollouts} rollouts, {simulated.certificate.label.value}",
        *(_gap_lines(gap, units) if gap else ["  the gap           was not searched for"]),
        *_assumptions((*simulated.assumptions[:-1], *(gap.assumptions if gap else ()))),
    ]
    return head + "\n" + escape("\n".join(lines))


def _headline(result: GapResult) -> str:
    return f"{result.requirement}  gap  ({_spec(result)}: {_sides(result)})"


def _spec(result: GapResult) -> str:
    return str(result.provenance["spec"])


def _sides(result: GapResult) -> str:
    return f"{result.provenance['sim']['backend']} against {result.provenance['real']['backend']}"


def _gap_lines(result: GapResult, units: Mapping[str, str]) -> list[str]:
    unit = f" {result.unit}" if result.unit else ""
    certificate = result.certificate
    failures = ", ".join(f"{count} × {word}" for word, count in sorted(result.failures.items())) or "no falls"
    reason = f" ({certificate.reason})" if certificate.reason else ""
    sure = f", with probability ≥ 1 − {certificate.delta:g}; anywhere in {between(result.low, result.high)}"
    computed = "" if certificate.label is not Label.REFUSED else " was computed, and is no promise"
    return [
        f"  worst expected Δ  in {between(result.lower, result.upper)}{unit}{computed or sure}",
        f"  worst gap at      {test_words(result.worst.params, units)}: mean Δ {result.worst.mean:+.4f}{unit}, "
        f"mean |Δ| {result.worst.absolute:.4f} over {result.worst.pairs} pairs",
        f"  largest mean |Δ|  {result.absolute:.4f}{unit} at a tested point (the paper's measure; an estimate)",
        f"  effort            {certificate.rollouts} rollouts of {result.provenance['real']['backend']} at "
        f"{certificate.points} tests, {failures}, "
        f"{result.seconds:.0f} s",
        f"  label             {certificate.label.value}{reason}",
    ]


def _assumptions(texts: tuple[str, ...]) -> list[str]:
    return ["", "  This assumes:", *(f"   - {text}" for text in dict.fromkeys(texts))]
