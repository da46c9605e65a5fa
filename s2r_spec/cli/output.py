"""Where a report goes, and in which form: the options that every command with a verdict has."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.cli import terminal
from s2r_spec.files import save

if TYPE_CHECKING:
    from s2r_spec.report.finding import Report

Format = Annotated[
    str | None,
    typer.Option("--format", help="text, json, junit, github or markdown.", show_default="text"),
]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", help="Write the report here and not to stdout.")
]
Page = Annotated[
    Path | None,
    typer.Option("--report", help="Write an HTML page with pictures here, too.", show_default=False),
]
AsJson = Annotated[bool, typer.Option("--json", help="The same as --format json: one object on stdout.")]


def settle(
    chosen: str | None, as_json: bool, output: Path | None, among: Collection[str] | None = None
) -> str:
    """Return the format's name; a wrong one, or a folder that is not there, is said before anything runs.

    Args:
        chosen: by ``--format``.
        as_json: whether ``--json`` is given.
        output: where to write, if not to stdout.
        among: the formats there are, if not all.

    Raises:
        UsageError: no such format, ``--json`` with another one, or nowhere to write to.
    """
    from s2r_spec.errors import UsageError
    from s2r_spec.report import reporter

    if as_json and chosen not in (None, "json"):
        raise UsageError(f"--json is --format json, but --format {chosen} is given, too: give one of them")
    name = "json" if as_json else chosen or "text"
    reporter(name, among)
    writable(output)
    return name


def pageable(page: Path | None) -> None:
    """Say before anything runs that a page cannot be made or written.

    Raises:
        UsageError: a package is missing, or there is nowhere to write to.
    """
    from s2r_spec.report import html

    if page is not None:
        writable(page)
        html.require_packages()


def writable(path: Path | None) -> None:
    """Say before anything runs that a file cannot be written because of where it is.

    Raises:
        UsageError: it is a folder, or its folder is not there.
    """
    from s2r_spec.errors import UsageError

    if path is not None and path.is_dir():
        raise UsageError(f"cannot write to {path}: it is a folder")
    if path is not None and not path.parent.is_dir():
        raise UsageError(f"cannot write {path}: there is no folder {path.parent}")


def emit(report: Report, name: str, output: Path | None) -> None:
    """Write a report to a file or to stdout, in colour on a terminal.

    Raises:
        UsageError: the file cannot be written.
    """
    from s2r_spec.report import reporter, text

    if output is not None:
        save(output, reporter(name)(report) + "\n")
    elif name == "text":
        terminal.console().print(text.markup(report))
    elif name == "github":
        terminal.print_commands(reporter(name)(report))
    elif name == "json":
        terminal.print_json(reporter(name)(report))
    else:
        print(reporter(name)(report))
