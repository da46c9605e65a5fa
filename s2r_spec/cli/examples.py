"""``s2r examples``: the specifications and traces that come with s2r, as files to try and to change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import save
from s2r_spec.base.json_values import line
from s2r_spec.base.shipped import shipped_folder
from s2r_spec.cli.options.search import AsJson
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say

_FIRST = "a1_velocity.stl", "traces/a1_velocity_fails.csv"
"""Definition: specification and trace of the first command to try."""

Folder = Annotated[Path, typer.Argument(help="Folder for the files; made if it does not exist.")]


def examples(folder: Folder = Path("specs"), as_json: AsJson = False) -> None:
    """Write the shipped specifications and traces into a folder. No file is overwritten.

    Requirements with a source lie in a folder for each kind of robot: legged, wheeled, arm, aerial.
    """
    with sentences(as_json):
        from shlex import join

        from s2r_spec.report.records.specs import ExamplesObject

        place = shipped_folder("specs")
        if place is None:
            raise UsageError(
                "this installation has no examples; install s2r again, from a wheel or a checkout"
            )
        paths = [
            *sorted(place.glob("*.stl")),
            *sorted(place.glob("*/*.stl")),
            *sorted(place.glob("traces/**/*.*")),
        ]
        targets = {folder / path.relative_to(place).as_posix(): path.read_bytes() for path in paths}
        if folder.exists() and not folder.is_dir():
            raise UsageError(f"cannot write the examples into {folder}: it is not a folder")
        existing = [target for target in targets if target.exists()]
        if existing:
            more = f" and {len(existing) - 1} more files exist" if len(existing) > 1 else " exists"
            raise UsageError(
                f"{existing[0]}{more} already, and nothing was written; give a folder without them: "
                f"s2r examples FOLDER"
            )
        for target, content in targets.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            save(target, content)
        if as_json:
            print(line(ExamplesObject(folder=str(folder), files=tuple(map(str, targets)))))
            return
        for target in targets:
            print(target)
        first = (str(folder / name) for name in _FIRST)
        say(f"Next: {join(['s2r', 'monitor', *first])}", error=True)
