"""Arguments and options that mean the same in every command that runs a search."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
        help="End a rollout that takes longer than so many seconds; it counts as a crash. 0: never.",
        show_default="60 s and 100 times what the backend declares; never for one that is not repeatable",
    ),
]
Run = Annotated[Path | None, typer.Option(help="Folder for the rollouts.", show_default="s2r-runs/…")]
Resume = Annotated[Path | None, typer.Option(help="Go on with the run in this folder.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing while running.")]
