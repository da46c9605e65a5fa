"""What a reporter needs to know: one finding for each requirement, whichever command found it.

A command turns its own result record into findings (:mod:`s2r_spec.report.checked` for ``s2r check``,
``gapped`` and ``certified`` for the other two); every reporter works on findings alone.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from s2r_spec.certify.check import Verdict
from s2r_spec.printable import one_line


@dataclass(frozen=True)
class Section:
    """A titled list of sentences, each of one line."""

    title: str
    lines: tuple[str, ...]

    def __post_init__(self) -> None:
        """See that no name in them breaks a line, or commands a terminal."""
        object.__setattr__(self, "lines", tuple(map(one_line, self.lines)))


@dataclass(frozen=True)
class Finding:
    """One requirement, in words: every text is one line, in whatever form it is reported.

    Attributes:
        name: of the requirement.
        verdict: holds, violated or unknown; of a gap, whether it is bounded as closely as was asked.
        word: for it, to be read first.
        refused: whether it is unknown because the certificate was refused.
        about: what was looked at, "a1_velocity.stl on backend sim".
        reason: one sentence for the verdict.
        headline: the bound in the form that decides, with its probability.
        facts: (name, text) rows, the bound first.
        sections: assumptions and what hangs on them.
        provenance: what fixes the run: seed, version, hashes.
        again: what the command ``replay`` runs again.
        replay: the command.
        file: the specification.
        line: where the requirement is written in it, counted from 1.
        seconds: of rollouts, those of all workers added up.
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
        """See that no name in it breaks a line, or commands a terminal."""
        for field in fields(self):
            if isinstance(value := getattr(self, field.name), str):
                object.__setattr__(self, field.name, one_line(value))
        object.__setattr__(self, "facts", tuple((one_line(n), one_line(text)) for n, text in self.facts))


@dataclass(frozen=True)
class Report:
    """What a command found.

    Attributes:
        command: "s2r check".
        findings: in the order of the requirements.
        exit_code: of the command.
        record: the same as one record, complete; its JSON object is what ``--format json`` prints.
    """

    command: str
    findings: tuple[Finding, ...]
    exit_code: int
    record: Any
