"""The command line: ``s2r check``, ``gap``, ``certify``, ``diagnose``, ``monitor`` and the other commands.

Each command has its own file, without mathematics. Exit codes: 0 holds, 1 violated, 2 usage or spec error,
3 unknown, 4 backend or internal error, 130 interrupted, 141 the reader of stdout closed it.
"""

from __future__ import annotations

import errno
import sys
import traceback

import typer

from s2r_spec import distribution
from s2r_spec.cli import (
    backends,
    certify,
    check,
    choose,
    common,
    diagnose,
    docs,
    examples,
    fmt,
    gap,
    lint,
    log,
    monitor,
    odds,
    plan,
    replay,
    report,
    terminal,
)

UNREAD = 141
"""Definition: exit code of a command whose output nobody reads any more, as in a shell: 128 + SIGPIPE."""
EXIT_CODES = "Exit codes: 0 holds, 1 violated, 2 usage or spec error, 3 unknown, 4 backend or internal error."


def _epilog(example: str, codes: bool = False) -> str:
    """Return the last lines of a command's help: an example, and the exit codes of a command with a verdict."""
    return f"Example: s2r {example}" + (f"\n\n{EXIT_CODES}" if codes else "")


app = typer.Typer(
    name="s2r",
    help="Test a robot's controller against a specification. Bound its worst case in simulation and on the machine, "
    "and find the cause of the gap between the two.",
    epilog=_epilog("check specs/a1_velocity.stl --backend sim", codes=True),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command(epilog=_epilog("check specs/a1_velocity.stl --backend sim --budget 200", codes=True))(check.check)
app.command("gap", epilog=_epilog("gap specs/a1_velocity.stl --sim sim --real twin:lab --budget 50"))(gap.gap)
app.command(
    "certify",
    epilog=_epilog("certify specs/a1_velocity.stl --sim sim --real twin:lab --budget 100", codes=True),
)(certify.certify)
app.command(epilog=_epilog("diagnose specs/a1_velocity.stl --sim sim --real twin:lab --budget 30"))(
    diagnose.diagnose
)
app.command(epilog=_epilog("plan specs/a1_velocity.stl --backend sim --time 30min"))(plan.plan)
app.command(epilog=_epilog("odds s2r-runs/night --B 0.5 --below 0"))(odds.odds)
app.command(epilog=_epilog("choose s2r-runs/soft s2r-runs/stiff", codes=True))(choose.choose)
app.command(epilog=_epilog("replay s2r-runs/night#3.0 --plot worst.svg"))(replay.replay)
app.command(epilog=_epilog("report s2r-runs/night --output night.html", codes=True))(report.report)
app.command(epilog=_epilog("backends sim"))(backends.backends)
app.command(epilog=_epilog("monitor specs/a1_velocity.stl specs/traces/a1_velocity_fails.csv", codes=True))(
    monitor.monitor
)
app.command(epilog=_epilog("log night.mcap"))(log.log)
app.command(epilog=_epilog("fmt --check specs/a1_velocity.stl"))(fmt.fmt)
app.command(epilog=_epilog("lint specs/a1_velocity.stl"))(lint.lint)
app.command(epilog=_epilog("examples"))(examples.examples)
app.command(epilog=_epilog("docs how-to/runs"))(docs.docs)


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
    terminal.prepare()
    try:
        application()
    except SystemExit as end:
        cause = end.__context__
        if isinstance(cause, OSError) and cause.errno == errno.EPIPE:
            # The parser's exit code 1 would mean that the requirement is violated.
            sys.exit(UNREAD)
        # The parser of the command line prints its errors on stderr only.
        if as_json and end.code == 2 and not common.error_was_printed():
            common.print_error(2, "the command line has an error: see stderr")
        raise
    except Exception:
        traceback.print_exc()
        print("error: this is a bug in s2r; the recorded rollouts are on disk", file=sys.stderr)
        if as_json:
            common.print_error(4, "a bug in s2r: see stderr")
        sys.exit(4)
