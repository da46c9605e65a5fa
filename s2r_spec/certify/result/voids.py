"""Void rollouts of a machine: their numbers, the assumption about them, and the limit on their share.

A rollout is void when something other than the robot ended it. It is kept but is not an outcome, and the same test runs
again. The bound counts only outcomes. So it holds if, given the test, being void is independent of the outcome that the
rollout would have had. No data can show this independence, but the data show how often it is needed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from s2r_spec.backend import assumptions_of, is_exclusive
from s2r_spec.certify.bound.certificate import ALL_COUNT, Certificate, Label
from s2r_spec.recordings import reading_rule
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.machine_journal import FALL
from s2r_spec.runs.repeatability import unchecked_assumptions
from s2r_spec.runs.scorer import Scorer

MOST_VOID = 1 / 20
"""Level: largest share of all rollouts that may be void (dimensionless). If outcomes differ by the whole range of ρ,
void rollouts can shift the mean by this share of the range."""
UNFINISHED = "unfinished"
"""Definition: word for a rollout that runs, or in which s2r was killed and that nobody resumed."""


def machine_fields(scorer: Scorer, void: str) -> dict[str, Any]:
    """Return the header fields of a backend beyond its name and hash: of logs and machines, and assumptions."""
    fields: dict[str, Any] = reading_rule.header_fields(scorer.backend)
    unchecked = unchecked_assumptions(scorer.backend, scorer.passed)
    if assumptions := [*assumptions_of(scorer.backend), *unchecked]:
        fields["assumptions"] = assumptions
    if is_exclusive(scorer.backend):
        fields["void"] = void
    return fields


def is_machine(header: Mapping[str, Any]) -> bool:
    """Return whether a header belongs to a machine, by the fields that :func:`machine_fields` wrote."""
    return "void" in header


def with_voids(assumption: str, header: Mapping[str, Any]) -> str:
    """Return an assumption of a search, with void rollouts excepted if the header's backend is a machine."""
    excepted = ALL_COUNT.replace("requested rollout", "rollout that is not void")
    return assumption.replace(ALL_COUNT, excepted) if is_machine(header) else assumption


def void_counts(journal: Journal) -> dict[str, int]:
    """Return word → number of rollouts that were void for this reason."""
    words = Counter(void.word for void in journal.voids)
    words.update(UNFINISHED for _ in journal.open)
    return dict(sorted(words.items()))


def void_words(counts: Mapping[str, int], outcomes: int) -> str:
    """Return the number of void rollouts and of outcomes, in words."""
    void = sum(counts.values())
    words = ", ".join(f"{count} × {word}" for word, count in sorted(counts.items()))
    return f"{void} of {outcomes + void} rollouts ({words})" if void else f"none of {outcomes} rollouts"


def machine_assumptions(backend: str, header: Mapping[str, Any], journal: Journal) -> tuple[str, ...]:
    """Return the assumptions about a backend and its void rollouts, each in one sentence."""
    own = (*header.get("assumptions", ()), *reading_rule.note({"backend": backend} | dict(header)))
    if not is_machine(header):
        return own
    counts = void_counts(journal)
    part = void_words(counts, len(journal))
    if header["void"] == FALL:
        return (
            *own,
            f"a rollout of {backend} that the link, the operator or a killed process ended counts as a fall "
            f"(--void fall)" + (f"; void and not counted: {part}" if counts else ""),
        )
    return (
        *own,
        f"which rollouts of {backend} are void (ended by the link, the operator or a killed process) does not depend "
        f"on their outcomes; run again: {part}",
    )


def without_too_many(certificate: Certificate, backend: str, journal: Journal) -> Certificate:
    """Return a certificate, refused if more than 1 in 20 rollouts were void."""
    counts = void_counts(journal)
    void = sum(counts.values())
    if void <= MOST_VOID * (len(journal) + void) or certificate.label is Label.REFUSED:
        return certificate
    reason = (
        f"{void_words(counts, len(journal))} of {backend} were void, more than 1 in {1 / MOST_VOID:.0f}: too many to "
        f"assume independent outcomes; remove the cause and begin a new run"
    )
    return replace(certificate, label=Label.REFUSED, reason=reason)
