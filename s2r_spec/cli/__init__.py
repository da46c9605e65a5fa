"""The command line: ``s2r check``, ``gap``, ``certify``, ``diagnose``, ``monitor`` and their helpers.

One file a command, no mathematics. Exit codes: 0 holds, 1 violated, 2 usage or
spec error, 3 unknown, 4 backend or internal error, 130 interrupted, 141 nobody read on.
"""

from __future__ import annotations

import errno
import sys
import traceback

import typer

from s2r_spec.cli import (
    backends,
    certify,
    check,
    choose,
    common,
    diagnose,
    docs,
    fmt,
    gap,
    lint,
    monitor,
    odds,
    plan,
    replay,
    report,
    terminal,
)

UNREAD = 141
"""As of a shell's command that writes to a pipe whose reader has gone: 128 + SIGPIPE."""
EXIT_CODES = "Exit codes: 0 holds, 1 violated, 2 usage or spec error, 3 unknown, 4 backend or internal error."

app = typer.Typer(
    name="s2r",
    help="What can you promise about the real machine, and why does it differ from the simulator?",
    epilog=EXIT_CODES,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command(epilog=EXIT_CODES)(check.check)
app.command("gap")(gap.gap)
app.command("certify", epilog=EXIT_CODES)(certify.certify)
app.command()(diagnose.diagnose)
app.command()(plan.plan)
app.command()(odds.odds)
app.command(epilog=EXIT_CODES)(choose.choose)
app.command()(replay.replay)
app.command(epilog=EXIT_CODES)(report.report)
app.command()(backends.backends)
app.command(epilog=EXIT_CODES)(monitor.monitor)
app.command()(fmt.fmt)
app.command()(lint.lint)
app.command()(docs.docs)


@app.callback(invoke_without_command=True)
def _root(
    version: bool = typer.Option(False, "--version", "-V", help="Print the version and exit."),
) -> None:
    if version:
        from importlib.metadata import version as version_of

        print(f"s2r {version_of('s2r')}")
        raise typer.Exit


def main(application: typer.Typer = app) -> None:
    """Run a command line, ``s2r`` by default; an unexpected exception is a bug, and exits with 4."""
    as_json = "--json" in sys.argv
    terminal.prepare()
    try:
        application()
    except SystemExit as end:
        cause = end.__context__
        if isinstance(cause, OSError) and cause.errno == errno.EPIPE:
            # The parser's own 1 would say that the requirement is violated.
            sys.exit(UNREAD)
        # What the parser of the command line refuses is said on stderr only.
        if as_json and end.code == 2 and not common.error_was_printed():
            common.print_error(2, "the command line is not understood: see stderr")
        raise
    except Exception:
        traceback.print_exc()
        print("error: this is a bug in s2r; what was recorded is on disk", file=sys.stderr)
        if as_json:
            common.print_error(4, "a bug in s2r: see stderr")
        sys.exit(4)
