"""The result as one JSON object."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from s2r_spec.certify.check import CheckResult

SCHEMA = "s2r.check/1"


def to_json(results: Sequence[CheckResult], exit_code: int) -> dict[str, Any]:
    """Return the record that everything else could be rendered from."""
    return {
        "schema": SCHEMA,
        "exit_code": exit_code,
        "results": [one(result) for result in results],
    }


def one(result: CheckResult) -> dict[str, Any]:
    """Return one requirement's record."""
    certificate = result.certificate.to_json()
    return {
        "requirement": result.requirement,
        "verdict": result.verdict.value,
        "reason": result.reason,
        "worst_expected_robustness": {
            "lower": result.lower,
            "upper": result.upper,
            "unit": result.unit,
            "epsilon": result.certificate.epsilon,
            "probability_at_least": 1 - result.certificate.delta,
            "delta": result.certificate.delta,
        },
        "label": result.certificate.label.value,
        "worst": asdict(result.worst),
        "lowest": asdict(result.lowest),
        "failures": result.failures,
        "assumptions": list(result.assumptions),
        # The search maximises −ρ; its record is kept in its own sign, and says so.
        "search": {"objective": "-rho"} | certificate,
        "provenance": result.provenance,
        "folder": str(result.folder),
        "replay": replay_line(result),
        "seconds": round(result.seconds, 3),
    }


def replay_line(result: CheckResult) -> str:
    """Return the command that runs the rollout of the lowest ρ again."""
    return f"s2r replay {result.folder}#{result.lowest.query}.{result.lowest.replicate}"


def render(results: Sequence[CheckResult], exit_code: int) -> str:
    """Return the object as text; no NaN and no infinity ever gets in."""
    return json.dumps(to_json(results, exit_code), allow_nan=False, indent=2, ensure_ascii=False)
