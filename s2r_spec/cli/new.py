"""``s2r new``: the first robot file, from a model, a policy and a deploy file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import save
from s2r_spec.cli.options.search import AsJson
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say


def new(
    robot: Annotated[
        Path, typer.Argument(help="Robot file to write, such as robot.toml.", show_default=False)
    ],
    model: Annotated[Path, typer.Option("--model", help="MuJoCo model, an XML file.", show_default=False)],
    policy: Annotated[
        str,
        typer.Option(
            "--policy", help="Policy: .onnx, TorchScript .pt, or control.py:act.", show_default="none"
        ),
    ] = "",
    deploy: Annotated[
        Path | None,
        typer.Option("--deploy", help="Deploy file of unitree_rl_lab, mjlab, rl_sar or unitree_rl_gym."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a robot file: what these files say, and marks where they do not say it. Nothing of them runs."""
    with sentences(as_json):
        from s2r_spec.backend import file_opener
        from s2r_spec.base.json_values import line
        from s2r_spec.report.records.backends import NewObject

        opener = file_opener(robot)
        if robot.exists():
            raise UsageError(f"{robot} exists already, and nothing was written; give another name")
        text, marks = opener.draft(robot, model, policy, deploy)
        save(robot, text)
        problem = opener.problem(robot)
        if as_json:
            print(line(NewObject(robot=str(robot), text=text, marks=marks, problem=problem)))
            return
        print(robot)
        for mark in marks:
            say(f"not stated: {mark}", error=True)
        if problem:
            say(f"before it runs: {problem}", error=True)
        else:
            say(f"Next: s2r backends {robot} --check", error=True)
