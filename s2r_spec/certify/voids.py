"""Void rollouts of a machine: what is said of them, and when they are too many.

A rollout is void when something else than the robot ended it. It is kept and is no outcome, and the same test runs
again. The bound counts outcomes only, so it holds if being void says nothing of the outcome that would have come: given
the test, the two are independent. No data can show that. What the data do show is how often the assumption is needed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from s2r_spec.backend import Backend, assumptions_of, is_exclusive
from s2r_spec.certify.certificate import ALL_COUNT, Certificate, Label
from s2r_spec.rollouts.journal import Journal
from s2r_spec.rollouts.machine_journal import FALL

MOST_VOID = 1 / 20
"""Level: part of the rollouts that were begun of which at most may be void (dimensionless). Of outcomes that differ by
the whole range of ρ such a part can hide that part of the range. Twice as much hides twice as much."""
UNFINISHED = "unfinished"
"""Definition: word for a rollout that runs, or in which s2r was killed and that nobody resumed."""


def about(backend: Backend, void: str) -> dict[str, Any]:
    """Return what a journal's header says of a backend besides its name and hash; of a simulator nothing."""
    found: dict[str, Any] = {}
    if assumptions := assumptions_of(backend):
        found["assumptions"] = list(assumptions)
    if is_exclusive(backend):
        found["void"] = void
    return found


def is_machine(header: Mapping[str, Any]) -> bool:
    """Return whether a header's backend is a machine, as :func:`about` wrote it."""
    return "void" in header


def with_voids(assumption: str, header: Mapping[str, Any]) -> str:
    """Return what a search assumes, with the void rollouts of a header's backend excepted if it is a machine."""
    excepted = ALL_COUNT.replace("rollout that was asked for", "rollout that is not void")
    return assumption.replace(ALL_COUNT, excepted) if is_machine(header) else assumption


def counted(journal: Journal) -> dict[str, int]:
    """Return word → how many rollouts were void so."""
    words = Counter(void.word for void in journal.voids)
    words.update(UNFINISHED for _ in journal.open)
    return dict(sorted(words.items()))


def listed(counts: Mapping[str, int]) -> str:
    """Return counts in words: "1 × killed, 2 × link"."""
    return ", ".join(f"{count} × {word}" for word, count in sorted(counts.items()))


def shown(counts: Mapping[str, int], outcomes: int) -> str:
    """Return what a report says of void rollouts beside so many outcomes."""
    void = sum(counts.values())
    return (
        f"{void} of {outcomes + void} rollouts ({listed(counts)})" if void else f"none of {outcomes} rollouts"
    )


def assumed(backend: str, header: Mapping[str, Any], journal: Journal) -> tuple[str, ...]:
    """Return what a statement about a backend assumes besides, each in one sentence.

    Args:
        backend: its name.
        header: with what :func:`about` wrote.
        journal: of its rollouts.
    """
    own = tuple(header.get("assumptions", ()))
    if not is_machine(header):
        return own
    counts = counted(journal)
    part = shown(counts, len(journal))
    if header["void"] == FALL:
        return (
            *own,
            f"a rollout of {backend} that the link, the operator or a killed process ended counts as a fall, as "
            f"--void fall says" + (f"; void and not counted: {part}" if counts else ""),
        )
    return (
        *own,
        f"whether a rollout of {backend} is void (ended by the link, the operator or a killed process, not by the "
        f"robot) does not depend on the outcome that it would have had; void and run again: {part}",
    )


def without_too_many(certificate: Certificate, backend: str, journal: Journal) -> Certificate:
    """Return a certificate, refused if more than 1 in 20 rollouts were void."""
    counts = counted(journal)
    void = sum(counts.values())
    if void <= MOST_VOID * (len(journal) + void) or certificate.label is Label.REFUSED:
        return certificate
    reason = (
        f"{shown(counts, len(journal))} of {backend} were void, more than 1 in {1 / MOST_VOID:.0f}: too many to "
        f"assume that they do not depend on the outcome; mend what ends them and begin a new run"
    )
    return replace(certificate, label=Label.REFUSED, reason=reason)
