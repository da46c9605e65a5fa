"""What most commands import and make before anything else: preloaded, see :mod:`tests.forked`."""

import functools
import sys
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numba  # noqa: F401
import numpy.ma  # noqa: F401
import scipy.stats  # noqa: F401
import typer.main

with suppress(ImportError):  # an extra
    import matplotlib.backends.backend_agg
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401

import s2r_spec.certify.check
import s2r_spec.cli.terminal.progress
import s2r_spec.diagnose
import s2r_spec.report.html  # noqa: F401
from s2r_spec.cli import app

SPEC = "signal x {m/s}\nparam p {rad} in [0, 1]\nrequire r: always[0 s, 1 s] (x <= 1 {m/s})\n"

# Typer makes every command of the application anew whenever it is called: here once, for all forks.
typer.main.get_command = functools.cache(typer.main.get_command)
list(typer.main.get_command(app).commands.values())

# One command loads what a command line loads when it is first parsed.
with TemporaryDirectory() as folder, redirect_stdout(StringIO()), suppress(SystemExit):
    path = Path(folder, "spec.stl")
    path.write_text(SPEC)
    before, sys.argv = sys.argv, ["s2r", "lint", str(path)]
    try:
        app()
    finally:
        sys.argv = before
