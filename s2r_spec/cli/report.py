"""``s2r report``: report a run on disk in any format; runs no rollout."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.cli.common import sentences
from s2r_spec.cli.groups import output_option
from s2r_spec.cli.output import AsJson, Output, Verbose, emit, settle, writable
from s2r_spec.cli.terminal import say
from s2r_spec.files import save

if TYPE_CHECKING:
    from s2r_spec.report.finding import Report
    from s2r_spec.report.parts import Run

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
        from s2r_spec.report.recompute import Kind, kind

        page = not as_json and form in (None, "html")
        if page:
            html.require_packages()
            writable(output)
        else:
            form = settle(form, as_json, output)
        runs, found = {Kind.CHECK: _checks, Kind.GAP: _gap, Kind.CERTIFY: _certify}[kind(run)](run)
        if page:
            path = output or run / "report.html"
            save(path, html.render(runs))
            say(path)
        else:
            emit(found, form or "text", output, verbose)
        raise typer.Exit(found.exit_code)


def _checks(folder: Path) -> tuple[list[Run], Report]:
    from s2r_spec.report import checked
    from s2r_spec.report.recompute import recompute
    from s2r_spec.rollouts.layout import runs_in

    runs = [recompute(one) for one in runs_in(folder)]
    return [*runs], checked.report([(one.spec, one.result) for one in runs], NAME)


def _gap(folder: Path) -> tuple[list[Run], Report]:
    from s2r_spec.report import gapped
    from s2r_spec.report.recompute import recompute_gap

    run = recompute_gap(folder)
    return [run], gapped.report(run.spec, run.result, NAME)


def _certify(folder: Path) -> tuple[list[Run], Report]:
    from s2r_spec.report import certified
    from s2r_spec.report.recompute import recompute_certify

    run = recompute_certify(folder)
    return [run], certified.report(run.spec, run.result, NAME)
