"""``s2r fmt``: the formatter of specifications."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.base.files import save
from s2r_spec.base.json_values import line
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say


class Target(StrEnum):
    """Output of the command."""

    stl = "stl"
    latex = "latex"


def fmt(
    specs: Annotated[list[Path], typer.Argument(help="Specifications, .stl files.", show_default=False)],
    check: Annotated[
        bool, typer.Option("--check", help="Change no file. The exit code is 1 if a file would change.")
    ] = False,
    to: Annotated[
        Target,
        typer.Option(help="stl: rewrite the files. latex: print the formulas as an align* environment."),
    ] = Target.stl,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Format specifications in the standard layout; comments stay."""
    with sentences(as_json):
        from s2r_spec.lang.files import read_text
        from s2r_spec.lang.latex import to_latex
        from s2r_spec.lang.printing import format_text
        from s2r_spec.report.records.specs import FormatObject, LatexObject

        texts = {path: read_text(path) for path in specs}
        if to is Target.latex:
            latex = {str(path): to_latex(text, str(path)) for path, text in texts.items()}
            print(line(LatexObject(latex=latex)) if as_json else "\n".join(latex.values()))
            return
        # all files are read and parsed before the first one is written
        written = {path: format_text(text, str(path)) for path, text in texts.items()}
        changed = [path for path in specs if written[path] != texts[path]]
        for path in changed:
            if not check:
                save(path, written[path])
            say(f"{'would change' if check else 'changed'} {path}", error=True)
        if as_json:
            print(line(FormatObject(check=check, changed=tuple(map(str, changed)))))
        raise typer.Exit(1 if check and changed else 0)
