"""Arguments and options that mean the same in every command that runs a search."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from s2r_spec.errors import UsageError

SpecFile = Annotated[Path, typer.Argument(help="The specification, a .stl file.", show_default=False)]
Simulator = Annotated[str, typer.Option(help="The simulator.")]
RealMachine = Annotated[
    str, typer.Option(help="The real machine: a robot, its logs, a twin.", show_default=False)
]
OneRequirement = Annotated[str | None, typer.Option("--requirement", "-r", help="If the spec has several.")]
Seed = Annotated[int, typer.Option(min=0, help="Fixes the whole run.")]
RealBudget = Annotated[
    int | None, typer.Option(min=1, help="Most real rollouts; without it, as many as ε takes.")
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Parallel rollouts; the numbers do not depend on it.",
        show_default="the cores of this machine",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Run rollouts on the workers of this Dask scheduler, tcp://HOST:PORT.", show_default=False
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(
        min=0,
        help="End a rollout that takes longer than so many seconds; it counts as a crash, or is void on a machine. "
        "0: never.",
        show_default="60 s and 100 times what the backend declares; never for one that is not repeatable",
    ),
]
Void = Annotated[
    str,
    typer.Option(
        help="A machine's rollout that the link, the operator or a killed process ended: again, or fall to count it as "
        "a fall. One fall among a hundred good rollouts is far from them, and usually refutes R and the certificate.",
    ),
]
Run = Annotated[Path | None, typer.Option(help="Folder for the rollouts.", show_default="s2r-runs/…")]
Resume = Annotated[Path | None, typer.Option(help="Go on with the run in this folder.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing while running.")]
Nan = Annotated[
    str | None,
    typer.Option(
        "--nan", help="A missing sample of a log: error, or hold for the one before it.", show_default="error"
    ),
]
TimeUnit = Annotated[
    str | None,
    typer.Option(
        "--time-unit",
        help="Unit of a log's times that are plain numbers: s, ms, us, ns, min.",
        show_default="as the log says, or s",
    ),
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        "-m",
        help="What a log calls a signal or t: vx=velocity.x, 'q[0]=q_0', t=stamp.sec+stamp.nanosec (repeat).",
    ),
]


READ = ("log:", "manual:")
"""Definition: how the names of backends begin that read logs."""


def missing(nan: str | None) -> Literal["error", "hold"]:
    """Return what a missing sample means: "error" or "hold".

    Raises:
        UsageError: it is neither.
    """
    if nan is None or nan == "error":
        return "error"
    if nan == "hold":
        return "hold"
    raise UsageError(f"--nan is error or hold, not {nan!r}")


def logs(names: Sequence[str], nan: str | None, unit: str | None, columns: Sequence[str] | None) -> list[str]:
    """Return names of backends, those of recordings with the options for logs added.

    Raises:
        UsageError: an option for logs is given, and none of them is a log; or its value is none.
    """
    from urllib.parse import quote

    words = [] if nan is None else [f"nan={missing(nan)}"]
    words += [] if unit is None else [f"time-unit={quote(unit)}"]
    words += [f"map={quote(text, safe='=[]+/:.')}" for text in columns or ()]
    if words and not any(name.startswith(READ) for name in names):
        raise UsageError(
            "--nan, --time-unit and --map are for recorded traces, and no log:FOLDER or manual:FOLDER is given"
        )
    if not words:
        return list(names)
    return [
        f"{name}{'&' if '?' in name else '?'}{'&'.join(words)}" if name.startswith(READ) else name
        for name in names
    ]
