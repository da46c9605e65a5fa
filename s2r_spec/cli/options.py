"""Arguments and options that have the same meaning in every command that runs a search."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from s2r_spec.errors import UsageError

SpecFile = Annotated[Path, typer.Argument(help="Specification, an .stl file.", show_default=False)]
Simulator = Annotated[str, typer.Option(help="Backend that simulates; see `s2r backends`.")]
RealMachine = Annotated[
    str,
    typer.Option(
        help="Backend of the real machine: a robot, its logs as log:FOLDER, or a twin.", show_default=False
    ),
]
OneRequirement = Annotated[
    str | None,
    typer.Option("--requirement", "-r", help="Requirement of the spec.", show_default="the only one"),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers: the same seed repeats the run.")]
RealBudget = Annotated[
    int | None, typer.Option(min=1, help="Most real rollouts.", show_default="until the interval is ε wide")
]
Stop = Annotated[
    str | None,
    typer.Option(
        help="When the search ends: epsilon (the interval is ε wide), decided (the verdict is known) or budget. The "
        "interval is valid under every rule.",
        show_default="epsilon, or the rule of the resumed run",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Number of parallel rollouts. It does not change the results.",
        show_default="one for each core",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Address of a Dask scheduler, tcp://HOST:PORT, whose workers run the rollouts.",
        show_default=False,
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(
        min=0,
        help="Time limit of a rollout in seconds; 0 for no limit. A rollout that takes longer is ended. It counts as a "
        "crash in simulation, and is void on a machine.",
        show_default="60 s plus 100 times the backend's declared cost; no limit for a backend that is not repeatable",
    ),
]
Void = Annotated[
    str,
    typer.Option(
        help="How to treat a void rollout: one that ended because of the link, the operator or a killed process, and "
        "not the robot. With again, its test is repeated. With fall, it counts as a fall; a single one usually refutes "
        "R and the certificate.",
    ),
]
Run = Annotated[
    Path | None, typer.Option(help="Folder for the rollouts.", show_default="a new one in s2r-runs")
]
Resume = Annotated[Path | None, typer.Option(help="Folder of a run to continue.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.")]
Nan = Annotated[
    str | None,
    typer.Option(
        "--nan",
        help="Missing samples of a log: error, or hold to repeat the sample before.",
        show_default="error",
    ),
]
TimeUnit = Annotated[
    str | None,
    typer.Option(
        "--time-unit",
        help="Unit of times that a log gives as plain numbers: s, ms, us, ns or min.",
        show_default="the log's own, or else s",
    ),
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        "-m",
        help="Column of a log for a signal or the time t, such as vx=velocity.x, 'q[0]=q_0' or "
        "t=stamp.sec+stamp.nanosec. May be repeated.",
        show_default="the signal's own name",
    ),
]


When = Annotated[
    str | None,
    typer.Option(
        help="Condition on channels of a log, such as 'vx_cmd > 0.05'. An episode begins where it becomes true.",
        show_default="the whole log is one trace",
    ),
]
Start = Annotated[
    float | None,
    typer.Option(min=0, help="Time of a log before which no episode begins, in seconds.", show_default="0"),
]
Duration = Annotated[
    float | None,
    typer.Option(
        min=0, help="Length of an episode in seconds.", show_default="as long as the requirement looks ahead"
    ),
]
Join = Annotated[
    Literal["hold", "linear"] | None,
    typer.Option(
        help="Values between the messages of a topic: hold the last one, or interpolate. For a table with empty cells, "
        "each column is a topic.",
        show_default="hold for a log of topics",
    ),
]
Clock = Annotated[
    str | None,
    typer.Option(help="Topic whose stamps the trace has.", show_default="the one with the most messages"),
]
Stamped = Annotated[
    Literal["header", "received"] | None,
    typer.Option(
        "--stamps",
        help="Stamps of ROS messages: those in their headers, or the times of receipt.",
        show_default="header if all topics have one, else received",
    ),
]


READ = ("log:", "manual:")
"""Definition: prefixes of the backends that read logs."""


def missing(nan: str | None) -> Literal["error", "hold"]:
    """Return the value of ``--nan``: "error" or "hold".

    Raises:
        UsageError: it is neither.
    """
    if nan is None or nan == "error":
        return "error"
    if nan == "hold":
        return "hold"
    raise UsageError(f"--nan must be error or hold, not {nan!r}")


def logs(names: Sequence[str], nan: str | None, unit: str | None, columns: Sequence[str] | None) -> list[str]:
    """Return the names of backends; the options for logs are added to those that read logs.

    Raises:
        UsageError: an option for logs is given but no backend reads logs, or its value is invalid.
    """
    from urllib.parse import quote

    words = [] if nan is None else [f"nan={missing(nan)}"]
    words += [] if unit is None else [f"time-unit={quote(unit)}"]
    words += [f"map={quote(text, safe='=[]+/:.')}" for text in columns or ()]
    if words and not any(name.startswith(READ) for name in names):
        raise UsageError(
            "--nan, --time-unit and --map are for recorded traces, but no log:FOLDER or manual:FOLDER is given"
        )
    if not words:
        return list(names)
    return [
        f"{name}{'&' if '?' in name else '?'}{'&'.join(words)}" if name.startswith(READ) else name
        for name in names
    ]
