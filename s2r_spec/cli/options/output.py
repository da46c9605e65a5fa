"""The options for a report's format and file, which every command with a verdict has."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import save
from s2r_spec.cli.options.groups import options, output_option
from s2r_spec.cli.terminal import terminal

if TYPE_CHECKING:
    from s2r_spec.report.finding import Report
    from s2r_spec.report.recompute import Certified

Output = Annotated[
    Path | None, output_option("--output", "-o", help="File for the report.", show_default="stdout")
]
AsJson = Annotated[
    bool, output_option("--json", help="Print one JSON object on stdout, as --format json does.")
]
Verbose = Annotated[
    bool,
    output_option(
        "--verbose", "-v", help="Print the assumptions, too, and the interval for each larger norm bound B."
    ),
]


@options
class Form:
    """The form and the files of a result; each field is an option."""

    as_json: AsJson = False
    form: str | None = output_option(
        None,
        "--format",
        help="Format of the report: text, json, junit, github or markdown.",
        show_default="text",
    )
    output: Output = None
    page: Path | None = output_option(
        None, "--report", help="Also write an HTML page with pictures to this file.", show_default=False
    )

    @property
    def json(self) -> bool:
        """Whether errors are printed as JSON, too."""
        return self.as_json or self.form == "json"

    def settled(self, among: Collection[str] | None = None) -> str:
        """Return the format's name, ``among`` those of the command, and check both files before anything runs.

        Raises:
            UsageError: the format is unknown or contradicts ``--json``, a file cannot be written, or a package of the
                HTML page is missing.
        """
        from s2r_spec.report import html, reporter

        if self.as_json and self.form not in (None, "json"):
            raise UsageError(
                f"--json means --format json, but --format {self.form} is given: give one of them"
            )
        name = "json" if self.as_json else self.form or "text"
        reporter(name, among)
        writable(self.output)
        if self.page is not None:
            writable(self.page)
            html.require_packages()
        return name

    def write_page(self, page: Callable[[], str]) -> None:
        """Write the HTML page if one is asked for."""
        if self.page is not None:
            save(self.page, page())


@options
class Writing(Form):
    """The form and the files of a report; each field is an option."""

    verbose: Verbose = False

    def emit(self, report: Report, name: str, results: Sequence[Certified]) -> None:
        """Write a report, and the HTML page of the results if one is asked for."""
        from s2r_spec.report import html
        from s2r_spec.report.recompute import recompute_again

        emit(report, name, self.output, self.verbose)
        self.write_page(lambda: html.render([recompute_again(result) for result in results]))


def writable(path: Path | None) -> None:
    """Check, before anything runs, that a file can be written there.

    Raises:
        UsageError: it is a folder, or its folder does not exist.
    """
    if path is not None and path.is_dir():
        raise UsageError(f"cannot write to {path}: it is a folder")
    if path is not None and not path.parent.is_dir():
        raise UsageError(f"cannot write {path}: there is no folder {path.parent}")


def emit(report: Report, name: str, output: Path | None, verbose: bool = False) -> None:
    """Write a report to a file or to stdout, in colour on a terminal; None is stdout.

    With ``verbose``, text on stdout has the assumptions and the interval for each larger B; a file has them always.

    Raises:
        UsageError: the file cannot be written.
    """
    from s2r_spec.report import reporter, text

    write(name, output, lambda: reporter(name)(report), lambda: text.markup(report, verbose))


def write(name: str, output: Path | None, text: Callable[[], str], markup: Callable[[], str]) -> None:
    """Write a result in the format ``name`` to a file or to stdout; as text on stdout it is ``markup``."""
    if output is not None:
        save(output, text() + "\n")
    elif name == "text":
        terminal.console().print(markup())
    elif name == "github":
        terminal.print_commands(text())
    elif name == "json":
        terminal.print_json(text())
    else:
        print(text())
