"""The input of every reporter: one finding for each requirement, from any command.

A command turns its own result record into findings (:mod:`s2r_spec.report.checked` for ``s2r check``,
``gapped`` and ``certified`` for the other two). A reporter reads only findings.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from s2r_spec.certify.check import Verdict
from s2r_spec.printable import one_line


@dataclass(frozen=True)
class Section:
    """A titled list of sentences, one line each."""

    title: str
    lines: tuple[str, ...]

    def __post_init__(self) -> None:
        """Escape line breaks and control characters in the lines."""
        object.__setattr__(self, "lines", tuple(map(one_line, self.lines)))


@dataclass(frozen=True)
class Finding:
    """The result of one requirement as text; every text is one line in every form of report.

    Attributes:
        name: the name of the requirement.
        verdict: holds, violated or unknown; for a gap, whether the bound is as narrow as requested.
        word: the verdict in one word, printed first.
        refused: whether the verdict is unknown because the certificate was refused.
        about: specification and backend, "a1_velocity.stl on backend sim".
        reason: one sentence for the verdict.
        headline: the deciding bound with its probability.
        facts: (name, text) rows, the bound first.
        sections: assumptions and their consequences.
        provenance: seed, version and hashes of the run.
        again: description of the rollout that ``replay`` runs again.
        replay: the command.
        file: the specification.
        line: line of the requirement in it, counted from 1.
        seconds: time of all rollouts [s], summed over workers.
    """

    name: str
    verdict: Verdict
    word: str
    refused: bool
    about: str
    reason: str
    headline: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    provenance: str
    again: str
    replay: str
    file: Path
    line: int
    seconds: float

    def __post_init__(self) -> None:
        """Escape line breaks and control characters in every text."""
        for field in fields(self):
            if isinstance(value := getattr(self, field.name), str):
                object.__setattr__(self, field.name, one_line(value))
        object.__setattr__(self, "facts", tuple((one_line(n), one_line(text)) for n, text in self.facts))


@dataclass(frozen=True)
class Report:
    """The result of a command.

    Attributes:
        command: "s2r check".
        findings: the findings, in the order of the requirements.
        exit_code: the exit code of the command.
        record: the complete result; ``--format json`` prints it.
    """

    command: str
    findings: tuple[Finding, ...]
    exit_code: int
    record: Any
