"""The choice among controllers: the one with the best certified worst case.

Each candidate is a backend: a controller, a gain, or a setting. Every candidate is checked by itself, with its own
δ_i. With probability ≥ 1 − Σ δ_i all intervals hold at once, whichever candidate is then chosen. So choosing after
the data costs nothing more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from s2r_spec.base.errors import UsageError
from s2r_spec.certify.check import CheckResult


@dataclass(frozen=True)
class Choice:
    """The candidate of the largest certified lower bound.

    Attributes:
        best: the index of the best candidate; None when every certificate was refused.
        lower: certified lower bound on its worst expected robustness.
        regret: the best candidate's worst case is better by at most this, in the unit of ρ.
        delta: 1 − probability of all these statements together.
        refused: indices of candidates without a certificate; no statement is about them.
    """

    best: int | None
    lower: float
    regret: float
    delta: float
    refused: tuple[int, ...]


def choose(results: Sequence[CheckResult]) -> Choice:
    """Choose among checks of one requirement.

    Raises:
        UsageError: there are fewer than two, or they are not of the same spec and requirement.
    """
    if len(results) < 2:
        raise UsageError("a choice needs at least two checks, one of each candidate")
    first = results[0]
    for other in results[1:]:
        same = other.provenance["spec_hash"] == first.provenance["spec_hash"]
        if not same or other.requirement != first.requirement:
            raise UsageError(
                f"{other.folder} checks {other.requirement!r} of a different spec from {first.folder}: "
                f"worst cases of different requirements cannot be compared"
            )
        backend = other.provenance["backend"]
        if any(one.provenance["backend"] == backend for one in results if one is not other):
            raise UsageError(f"{backend!r} is among the candidates twice; name each backend once")
    refused = tuple(i for i, r in enumerate(results) if not r.certificate.label.bounds)
    able = [i for i in range(len(results)) if i not in refused]
    delta = min(1.0, sum(r.certificate.delta for r in results))
    if not able:
        return Choice(None, float("-inf"), float("inf"), delta, refused)
    best = max(able, key=lambda i: results[i].lower)
    lower = results[best].lower
    regret = max([0.0, *(results[i].upper - lower for i in able if i != best)])
    return Choice(best, lower, regret, delta, refused)
