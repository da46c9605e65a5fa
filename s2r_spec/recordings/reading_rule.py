"""The rule by which recorded messages become samples, by number.

ρ of a log depends on this rule: which messages become samples, which instants are evaluated, and the values between.
So the header of a run on ``log:`` or ``manual:`` holds its number as ``reading``, and the hash of such a backend
depends on it. A run that another rule read cannot be resumed: its certificate would mix two evaluations.

Traces of simulators and robots have all channels at common samples, so their runs have no such number. Runs on logs
without a number were read by rule 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol, runtime_checkable

from s2r_spec.backend import Backend
from s2r_spec.base.json_values import to_json

READING = 3
"""Definition: the rule of this version. A change of ρ of any recorded log needs the next number."""
FIRST = 1
"""Definition: the rule of runs on logs whose header has no number."""
KEY = "reading"
"""Definition: name of the header's field."""
ACCOUNTS = "accounts"
"""Definition: name of the header's field with the accounts of messages."""
KINDS = ("log:", "manual:")
"""Definition: how the names of backends begin that read logs."""


@runtime_checkable
class ReadsLogs(Protocol):
    """A backend whose traces are read from logs; ``reading`` is the number of the rule."""

    reading: int


def header_fields(backend: Backend) -> dict[str, Any]:
    """Return the rule's number and the accounts of messages of a backend; one that reads no logs has neither."""
    if not isinstance(backend, ReadsLogs):
        return {}
    accounts = getattr(backend, "accounts", {})
    return {KEY: backend.reading} | ({ACCOUNTS: to_json(accounts)} if accounts else {})


def rule_of(about: Mapping[str, Any]) -> int | None:
    """Return the rule of a system from its part of a header; None if it read no logs."""
    read = str(about.get("backend", "")).startswith(KINDS)
    rule: int | None = about.get(KEY, FIRST if read else None)
    return rule


def changes(
    header: Mapping[str, Any], now: Mapping[str, Any], systems: Iterable[str]
) -> Iterator[tuple[str, int, int]]:
    """Yield (backend, its rule, the rule now) of each system of a run that another rule read.

    ``now`` is the header that the run would have now; ``systems`` are a header's fields with a part for each system.
    """
    for before, after in [(header, now), *((header.get(side), now.get(side)) for side in systems)]:
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            old, new = rule_of(before), rule_of(after)
            if old is not None and new is not None and old != new:
                yield str(before.get("backend")), old, new


def note(about: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a sentence on a system that another rule read, from its part of a header; none for this version's."""
    rule = rule_of(about)
    if rule in (None, READING):
        return ()
    return (
        f"the logs of {about['backend']} were read by reading rule {rule}. This version of s2r has rule {READING}, so "
        f"that a new run may give another ρ",
    )
