"""``s2r report``: report a run on disk in any format; runs no rollout."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.files import save
from s2r_spec.cli.options.groups import output_option
from s2r_spec.cli.options.output import AsJson, Output, Verbose, emit, settle, writable
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say

if TYPE_CHECKING:
    from s2r_spec.report.finding import Report
    from s2r_spec.report.sections import Run

NAME = "s2r report"


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
        from s2r_spec.report.recompute import RunKind, kind

        page = not as_json and form in (None, "html")
        if page:
            html.require_packages()
            writable(output)
        else:
            form = settle(form, as_json, output)
        runs, result = {RunKind.CHECK: _checks, RunKind.GAP: _gap, RunKind.CERTIFY: _certify}[kind(run)](run)
        if page:
            path = output or run / "report.html"
            save(path, html.render(runs))
            say(path)
        else:
            emit(result, form or "text", output, verbose)
        raise typer.Exit(result.exit_code)


def _checks(folder: Path) -> tuple[list[Run], Report]:
    from s2r_spec.report import check as check_report
    from s2r_spec.report.recompute import recompute
    from s2r_spec.runs.layout import runs_in

    runs = [recompute(one) for one in runs_in(folder)]
    return [*runs], check_report.report([(one.spec, one.result) for one in runs], NAME)


def _gap(folder: Path) -> tuple[list[Run], Report]:
    from s2r_spec.report import gap as gap_report
    from s2r_spec.report.recompute import recompute_gap

    run = recompute_gap(folder)
    return [run], gap_report.report(run.spec, run.result, NAME)


def _certify(folder: Path) -> tuple[list[Run], Report]:
    from s2r_spec.report import certify as certify_report
    from s2r_spec.report.recompute import recompute_certify

    run = recompute_certify(folder)
    return [run], certify_report.report(run.spec, run.result, NAME)
