"""``s2r lint``: mistakes of a specification, and warnings about legal parts that are seldom meant."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.files import save
from s2r_spec.base.json_values import line
from s2r_spec.cli.terminal.common import sentences

if TYPE_CHECKING:
    from s2r_spec.lang.diagnostics import Diagnostic
    from s2r_spec.lang.lints import LintWarning


def lint(
    specs: Annotated[list[Path], typer.Argument(help="Specifications, .stl files.", show_default=False)],
    fix: Annotated[
        bool,
        typer.Option(
            "--fix", help="Add brackets that show how a formula is read; its meaning does not change."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Report mistakes, and parts of a specification that are easily misread. Exit code 1 if there are any."""
    with sentences(as_json):
        from s2r_spec.lang.diagnostics import SpecError
        from s2r_spec.lang.files import read_text
        from s2r_spec.lang.lints import apply_fixes
        from s2r_spec.lang.lints import lint as findings_of
        from s2r_spec.report.records.specs import LintFinding, LintObject

        texts = {path: read_text(path) for path in specs}
        flat: list[LintWarning | Diagnostic] = []
        for path, text in texts.items():
            try:
                findings = findings_of(text, str(path))
            except SpecError as error:
                flat += error.diagnostics
                continue
            if fix and any(finding.edits for finding in findings):
                save(path, apply_fixes(text, findings))
            flat += [finding for finding in findings if not (fix and finding.edits)]
        if as_json:
            rows = (
                LintFinding(
                    file=f.span.source.name,
                    line=f.span.line,
                    column=f.span.column,
                    code=f.code,
                    message=f.message,
                    fix=f.fix,
                )
                for f in flat
            )
            print(line(LintObject(findings=tuple(rows))))
        elif flat:
            print("\n\n".join(map(str, flat)))
        raise typer.Exit(1 if flat else 0)
