"""The objects of the commands for specifications alone: ``s2r lint``, ``s2r fmt`` and ``s2r examples``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class LintFinding:
    """One place that is wrong or worth a second look.

    Attributes:
        file: the specification.
        line: the line of the finding, counted from 1.
        column: the column of the finding, counted from 1.
        code: the code of the rule, or of the mistake.
        message: the finding in one sentence.
        fix: the text to write instead; empty if there is none.
    """

    file: str
    line: int
    column: int
    code: str
    message: str
    fix: str


@dataclass(frozen=True, kw_only=True)
class LintObject:
    """The result of ``s2r lint``.

    Attributes:
        findings: the findings of all specifications.
    """

    schema: Literal["s2r.lint/1"] = "s2r.lint/1"
    findings: tuple[LintFinding, ...]


@dataclass(frozen=True, kw_only=True)
class LatexObject:
    """The result of ``s2r fmt --to latex``.

    Attributes:
        latex: specification → its formulas as ``align*``.
    """

    schema: Literal["s2r.latex/1"] = "s2r.latex/1"
    latex: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class FormatObject:
    """The result of ``s2r fmt``.

    Attributes:
        check: whether the files were left unchanged.
        changed: the files that were changed, or would be.
    """

    schema: Literal["s2r.fmt/1"] = "s2r.fmt/1"
    check: bool
    changed: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ExamplesObject:
    """The result of ``s2r examples``.

    Attributes:
        folder: the folder that got the files.
        files: the files that were written, specifications first.
    """

    schema: Literal["s2r.examples/1"] = "s2r.examples/1"
    folder: str
    files: tuple[str, ...]
