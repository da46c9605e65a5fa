"""The command line: ``s2r check``, ``gap``, ``certify``, ``diagnose``, ``monitor`` and the other commands.

Each command has its own file, without mathematics. Exit codes: 0 holds, 1 violated, 2 usage or spec error,
3 unknown, 4 backend or internal error, 130 interrupted, 141 the reader of stdout closed it.
"""

from __future__ import annotations

import errno
import os
import sys
import traceback

import typer

from s2r_spec.base import distribution
from s2r_spec.cli.commands import CommandGroup, epilog
from s2r_spec.cli.terminal import common
from s2r_spec.cli.terminal.terminal import prepare

UNREAD = 141
"""Definition: exit code of a command whose output nobody reads any more, as in a shell: 128 + SIGPIPE."""

app = typer.Typer(
    name="s2r",
    cls=CommandGroup,
    help="Test a robot's controller against a specification. Bound its worst case in simulation and on the machine, "
    "and find the cause of the gap between the two.",
    epilog=epilog("check specs/a1_velocity.stl --backend sim", codes=True),
    no_args_is_help=True,
    rich_markup_mode=None,  # typer's other modes import rich.markdown, for longer than all else takes
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def _root(
    version: bool = typer.Option(False, "--version", "-V", help="Print the version and exit."),
) -> None:
    if version:
        print(f"s2r {distribution.version()}")
        raise typer.Exit


def main(application: typer.Typer = app) -> None:
    """Run a command line, ``s2r`` by default; an unexpected exception is a bug and exits with 4."""
    as_json = "--json" in sys.argv
    prepare()
    try:
        application()
    except SystemExit as end:
        cause = end.__context__
        if isinstance(cause, OSError) and cause.errno == errno.EPIPE:
            # The parser's exit code 1 would mean that the requirement is violated, and a failed flush at exit 120.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            for stream in (sys.stdout, sys.stderr):
                os.dup2(nowhere, stream.fileno())
            sys.exit(UNREAD)
        # The parser of the command line prints its errors on stderr only.
        if as_json and end.code == 2 and not common.answered.is_set():
            common.print_error(2, "the command line has an error: see stderr")
        raise
    except Exception:
        traceback.print_exc()
        print("error: this is a bug in s2r; the recorded rollouts are on disk", file=sys.stderr)
        if as_json:
            common.print_error(4, "a bug in s2r: see stderr")
        sys.exit(4)
