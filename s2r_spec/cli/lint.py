"""``s2r lint``: warnings about legal parts of a specification that are seldom meant."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.cli.common import sentences
from s2r_spec.files import save
from s2r_spec.json_values import line


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
    """Report parts of a specification that are easily misread. Exit code 1 if there are any."""
    with sentences(as_json):
        from s2r_spec.json_objects.specs import LintFinding, LintObject
        from s2r_spec.lang.files import read_text
        from s2r_spec.lang.lints import fixed
        from s2r_spec.lang.lints import lint as findings_of

        texts = {path: read_text(path) for path in specs}
        findings = {path: findings_of(text, str(path)) for path, text in texts.items()}
        if fix:
            for path, text in texts.items():
                if any(finding.edits for finding in findings[path]):
                    save(path, fixed(text, findings[path]))
            findings = {path: tuple(f for f in found if not f.edits) for path, found in findings.items()}
        flat = [finding for found in findings.values() for finding in found]
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
