"""``s2r report``: a run on disk as a page, or in any other form; nothing is run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.cli.common import sentences
from s2r_spec.cli.output import AsJson, Output, emit, save, settle, writable


def report(
    run: Annotated[
        Path,
        typer.Argument(help="Folder of a run, finished or not, as `s2r check` names it.", show_default=False),
    ],
    form: Annotated[
        str | None,
        typer.Option("--format", help="html, text, json, junit, github or markdown.", show_default="html"),
    ] = None,
    output: Output = None,
    as_json: AsJson = False,
) -> None:
    """Compute the certificate of a run again from its rollouts, and report it; a page lands in the run's folder."""
    with sentences(as_json or form == "json"):
        from s2r_spec.report import checked, html
        from s2r_spec.report.recompute import recompute, runs_in

        page = not as_json and form in (None, "html")
        if page:
            html.require_packages()
            writable(output)
        else:
            form = settle(form, as_json, output)
        runs = [recompute(folder) for folder in runs_in(run)]
        found = checked.report([(one.spec, one.result) for one in runs], "s2r report")
        if page:
            path = output or run / "report.html"
            save(html.render(runs), path)
            print(path)
        else:
            emit(found, form or "text", output)
        raise typer.Exit(found.exit_code)
