"""The input of every reporter: one finding for each requirement, from any command.

A command turns its own result record into findings (:mod:`s2r_spec.report.check` for ``s2r check``,
``gapped`` and ``certified`` for the other two). A reporter reads only findings.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from s2r_spec.base.json_types import Location
from s2r_spec.base.printable import one_line
from s2r_spec.base.verdict import Verdict


@dataclass(frozen=True)
class Finding:
    """The result of one requirement as text; every text is one line in every form of report.

    Attributes:
        verdict: holds, violated or unknown; for a gap, whether the bound is as narrow as requested.
        word: the verdict in one word, printed first.
        refused: whether the verdict is unknown because the certificate was refused.
        about: specification and backend, "a1_velocity.stl on backend sim".
        headline: the deciding bound with its probability.
        facts: (name, text) rows, the bound first.
        ladder: the bound for each norm bound B, and what the data refute, one line each.
        provenance: seed, version and hashes of the run.
        again: description of the rollout that ``replay`` runs again.
        seconds: wall time of all rollouts [s], summed over workers.
    """

    name: str
    verdict: Verdict
    word: str
    refused: bool
    about: str
    reason: str
    headline: str
    facts: tuple[tuple[str, str], ...]
    assumptions: tuple[str, ...]
    ladder: tuple[str, ...]
    provenance: str
    again: str
    replay: str
    location: Location
    seconds: float

    def __post_init__(self) -> None:
        """Escape line breaks and control characters in every text."""
        for field in fields(self):
            object.__setattr__(self, field.name, _escape(getattr(self, field.name)))

    @property
    def sections(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """(title, lines) of the assumptions and their consequences."""
        return (
            ("This assumes", self.assumptions),
            ("Interval for larger B (all rows hold at once)", self.ladder),
        )


def _escape(value: Any) -> Any:
    if isinstance(value, str):
        return one_line(value)
    return tuple(map(_escape, value)) if isinstance(value, tuple) else value


@dataclass(frozen=True)
class Report:
    """The result of a command.

    Attributes:
        command: "s2r check".
        record: the complete result; ``--format json`` prints it.
    """

    command: str
    findings: tuple[Finding, ...]
    exit_code: int
    record: Any
