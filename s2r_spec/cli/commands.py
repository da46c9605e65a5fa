"""The commands of ``s2r``, each made when it is needed.

A command line needs one command, and the list of commands needs only their names and docstrings. To make a command,
typer evaluates the annotation of each of its options, which takes longer than the import of its module.
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable
from functools import cache
from importlib import import_module
from inspect import getdoc
from typing import Any

import typer
import typer.main
from typer.core import TyperGroup

from s2r_spec.cli.options import groups

EXIT_CODES = "Exit codes: 0 holds, 1 violated, 2 usage or spec error, 3 unknown, 4 backend or internal error."
EXAMPLES = {
    "check": "check specs/a1_velocity.stl --backend sim --budget 200",
    "gap": "gap specs/a1_velocity.stl --sim sim --real twin:lab --budget 50",
    "certify": "certify specs/a1_velocity.stl --sim sim --real twin:lab --budget 100",
    "diagnose": "diagnose specs/a1_velocity.stl --sim sim --real twin:lab --budget 30",
    "pilot": "pilot specs/turtlebot.stl --backend turtlebot",
    "plan": "plan specs/a1_velocity.stl --backend sim --time 30min",
    "odds": "odds s2r-runs/night --B 0.5 --below 0",
    "choose": "choose s2r-runs/soft s2r-runs/stiff",
    "replay": "replay s2r-runs/night#3.0 --plot worst.svg",
    "report": "report s2r-runs/night --output night.html",
    "new": "new robot.toml --model scene.xml --policy policy.onnx --deploy deploy.yaml",
    "backends": "backends sim",
    "monitor": "monitor specs/a1_velocity.stl specs/traces/a1_velocity_fails.csv",
    "log": "log specs/traces/drive.mcap",
    "fmt": "fmt --check specs/a1_velocity.stl",
    "lint": "lint specs/a1_velocity.stl",
    "examples": "examples",
    "docs": "docs how-to/runs",
}
"""Command → example, in the order of the help. A command is the function of its name in the module of its name."""
WITH_VERDICT = frozenset({"check", "certify", "choose", "report", "monitor"})
"""Definition: commands with a verdict, whose help lists the exit codes."""


def epilog(example: str, codes: bool = False) -> str:
    """Return the last lines of a command's help: an example, and the exit codes of a command with a verdict."""
    return f"Example: s2r {example}" + (f"\n\n{EXIT_CODES}" if codes else "")


class CommandGroup(TyperGroup):
    """The group of all commands."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = _Commands(EXAMPLES)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options before the command's name."""
        for parameter in self.get_params(ctx):
            if parameter.default is None:  # a flag of typer: to convert None, it would import pydantic
                parameter.default = False
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the name of each command and the first paragraph of its docstring."""
        summaries = {name: (getdoc(_function(name)) or "").split("\n\n")[0] for name in self.commands}
        with formatter.section("Commands"):
            formatter.write_dl([(name, " ".join(text.split())) for name, text in summaries.items()])


class _Commands(UserDict[str, Any]):
    """Name → command of typer, made when it is looked up."""

    def __getitem__(self, name: str) -> Any:
        return _command(name, super().__getitem__(name))


@cache
def _command(name: str, example: str) -> Any:
    application = typer.Typer(add_completion=False, rich_markup_mode=None)
    application.command(name, cls=groups.GroupedCommand, epilog=epilog(example, name in WITH_VERDICT))(
        _function(name)
    )
    return typer.main.get_command(application)


def _function(name: str) -> Callable[..., None]:
    function: Callable[..., None] = getattr(import_module(f"s2r_spec.cli.{name}"), name)
    return function
