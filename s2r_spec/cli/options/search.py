"""Arguments and options that have the same meaning in every command that runs rollouts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.cli.options.groups import options, output_option, search_option

if TYPE_CHECKING:
    from s2r_spec.spec import Spec

SpecFile = Annotated[Path, typer.Argument(help="Specification, an .stl file.", show_default=False)]
Simulator = Annotated[
    str, typer.Option(help="Backend that simulates, such as sim or cart.py:Cart; see `s2r backends`.")
]
OneRequirement = Annotated[
    str | None,
    typer.Option("--requirement", "-r", help="Requirement of the spec.", show_default="the only one"),
]
Seed = Annotated[
    int | None,
    search_option(
        min=0,
        help="Seed of all random numbers: the same seed repeats the run.",
        show_default="0, or the seed of the resumed run",
    ),
]
Workers = Annotated[
    int | None,
    search_option(
        min=1,
        help="Number of parallel rollouts. It does not change the results.",
        show_default="one for each core",
    ),
]
Scheduler = Annotated[
    str | None,
    search_option(
        help="Address of a Dask scheduler, tcp://HOST:PORT, whose workers run the rollouts.",
        show_default=False,
    ),
]


AsJson = Annotated[bool, output_option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, output_option("--quiet", "-q", help="Print no progress.")]

Mode = Annotated[str, search_option(help="Method of the bound: rigorous, rigorous-simple or paper.")]
RunFolder = Annotated[Path, typer.Argument(help="Folder of a check, finished or not.", show_default=False)]


@options
class Compared:
    """The simulator and the machine that are compared, and by which requirement; each field is an option."""

    real: str = typer.Option(
        ...,
        help="Backend of the real machine: a robot, its logs as log:FOLDER, or a twin.",
        show_default=False,
    )
    sim: Simulator = "sim"
    requirement: OneRequirement = None

    def requirements(self, spec: Spec) -> list[str]:
        """Return the requirement, or all that may be the only one."""
        return [self.requirement] if self.requirement else list(spec.requirements)


@options
class Rules:
    """When a search ends, and how rollouts without a result count; each field is an option."""

    seed: Seed = None
    stop: str | None = search_option(
        None,
        help="When the search ends: decided (the verdict is known, or the interval is ε wide), epsilon (the interval "
        "is ε wide) or budget. The interval is valid under every rule.",
        show_default="decided in check, epsilon in gap and certify, or the rule of the resumed run",
    )
    timeout: float | None = search_option(
        None,
        min=0,
        help="Time limit of a rollout in seconds; 0 for no limit. A simulated rollout may use this much CPU time, and "
        "ten times as much wall time. A machine's rollout has this limit in wall time. A rollout that takes longer is "
        "ended: it counts as a crash in simulation, and is void on a machine.",
        show_default="60 s plus 100 times the backend's declared cost; no limit for a backend that is not repeatable",
    )
    void: str = search_option(
        "again",
        help="How to treat a void rollout: one that ended because of the link, the operator or a killed process, and "
        "not the robot. With again, its test is repeated. With fall, it counts as a fall; a single one usually refutes "
        "R and the certificate.",
    )

    @property
    def limit(self) -> float | None:
        """The time limit of a rollout for the library [s]: 0 on the command line means no limit."""
        return math.inf if self.timeout == 0 else self.timeout


@options
class Running:
    """Where rollouts run, and where they are kept; each field is an option."""

    workers: Workers = None
    scheduler: Scheduler = None
    run: Path | None = search_option(
        None, help="Folder for the rollouts.", show_default="a new one in s2r-runs"
    )
    resume: Path | None = search_option(None, help="Folder of a run to continue.")
    quiet: Quiet = False
