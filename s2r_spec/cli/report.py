"""``s2r report``: report a run on disk in any format; runs no rollout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.base.files import save
from s2r_spec.cli.options.groups import output_option
from s2r_spec.cli.options.output import AsJson, Form, Output, Verbose, emit, writable
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say


def report(
    run: Annotated[
        Path,
        typer.Argument(help="Folder of a run, finished or not.", show_default=False),
    ],
    form: Annotated[
        str | None,
        output_option(
            "--format",
            help="Format of the report: html, text, json, junit, github or markdown.",
            show_default="html",
        ),
    ] = None,
    output: Output = None,
    as_json: AsJson = False,
    verbose: Verbose = False,
) -> None:
    """Compute a run's certificate again from its rollouts, and report it; HTML goes to the run's folder."""
    with sentences(as_json or form == "json"):
        from s2r_spec.report import html
        from s2r_spec.report.certify import report_of
        from s2r_spec.report.recompute import recompute_all

        page = not as_json and form in (None, "html")
        if page:
            html.require_packages()
            writable(output)
        else:
            form = Form(as_json=as_json, form=form, output=output, page=None).settled()
        # JSON has all digits, and equals that of the run.
        runs = recompute_all(run)
        result = report_of([one.result for one in runs], "s2r report")
        if page:
            path = output or run / "report.html"
            save(path, html.render(runs))
            say(path)
        else:
            emit(result, form or "text", output, verbose)
        raise typer.Exit(result.exit_code)
