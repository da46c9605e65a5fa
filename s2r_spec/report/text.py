"""The result as a roboticist reads it in ten seconds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from s2r_spec.certify.check import CheckResult, Verdict
from s2r_spec.report.jsonform import replay_line

COLOURS = {Verdict.HOLDS: "bold green", Verdict.VIOLATED: "bold red", Verdict.UNKNOWN: "bold yellow"}


def render(results: Sequence[CheckResult], units: Mapping[str, str]) -> str:
    """Return rich markup for the results; ``units`` are those of the test parameters."""
    return "\n\n".join(_one(result, units) for result in results)


def _one(result: CheckResult, units: Mapping[str, str]) -> str:
    certificate, source = result.certificate, result.provenance
    unit = f" {result.unit}" if result.unit else ""
    failures = ", ".join(f"{count} × {word}" for word, count in sorted(result.failures.items())) or "no falls"
    test = test_words(result.worst.params, units)
    lines = [
        f"{result.requirement}  [{COLOURS[result.verdict]}]{result.verdict.name}[/]  "
        f"({source['spec']} on backend {source['backend']})",
        f"  {result.reason}",
        "",
        f"  worst expected ρ  in \\[{result.lower:+.4f}, {result.upper:+.4f}]{unit}, "
        f"with probability ≥ 1 − {certificate.delta:g}",
        f"  worst test        {test}: mean ρ {result.worst.mean:+.4f}{unit} over {result.worst.rollouts} rollouts, "
        f"lowest {result.worst.lowest:+.4f}",
        f"  effort            {certificate.rollouts} rollouts at {certificate.points} tests, {failures}, "
        f"{result.seconds:.0f} s",
        f"  label             {certificate.label.value}; interval {certificate.epsilon:.4f} wide "
        f"(asked {certificate.target:g}), of which the grid costs {certificate.discretisation:.2g}",
        "",
        "  This assumes:",
        *(f"   - {text}" for text in result.assumptions),
        "  How much hangs on B (all rows hold at once):",
        *(
            f"   - if B = {rung.B:g}{unit}: ρ in \\[{-rung.upper:+.4f}, {-rung.lower:+.4f}]{unit}"
            for rung in certificate.ladder
        ),
        f"   - the data refute every B < {certificate.B_low:.3g}{unit}; R is refuted at an e-value of 1/δ, "
        f"now {math.exp(min(certificate.log_e_value, 700.0)):.3g}",
        "",
        f"  seed {source['seed']}, s2r {source['s2r']}, spec {source['spec_hash'][:12]}, "
        f"model {source['model_hash'][:12]}",
        f"  lowest ρ ({result.lowest.rho:+.4f}{unit}) again:  {replay_line(result)}",
    ]
    return "\n".join(lines)


def test_words(params: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return ``vd = 0.3 m/s, slope = 2 deg``."""
    return ", ".join(f"{name} = {value:.4g} {units.get(name, '')}".rstrip() for name, value in params.items())
