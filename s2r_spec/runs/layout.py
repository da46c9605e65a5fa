"""The folders of a run's journals, and the folder to pass to ``--resume``.

s2r check      RUN/<requirement>
s2r gap        RUN/sim  RUN/real
s2r certify    RUN/simulation  RUN/gap/sim  RUN/gap/real
from Python    the argument ``folder`` of ``check`` and ``check_measure``
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from s2r_spec.base.errors import UsageError

FILE = "journal.jsonl"
"""Definition: name of a journal in its folder."""
SYSTEMS = ("sim", "real")
"""The two systems of a gap, simulator and machine: folders of their journals, and fields of a journal's header."""
SIMULATION, GAP = "simulation", "gap"
"""Folders of the two searches of ``s2r certify``."""


RUNS = Path("s2r-runs")
"""Definition: the folder of new runs, in the folder in which s2r was started."""
_LONGEST_NAME = 150
"""Budget: letters of the spec's and backends' names in the name of a run's folder; a file name has 255 bytes."""


def new_run(name: str, seed: int) -> Path:
    """Make a new folder below :data:`RUNS`, named by the time to the second; a number is added if the name is taken."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    # The name of a backend may be a path, as in log:FOLDER.
    plain = re.sub(r"[^\w.,+=-]", "-", name, flags=re.ASCII)[:_LONGEST_NAME]
    try:
        RUNS.mkdir(parents=True, exist_ok=True)
        for number in itertools.count(1):
            folder = RUNS / f"{stamp}-{plain}-seed{seed}{f'-{number}' if number > 1 else ''}"
            with suppress(FileExistsError):
                folder.mkdir()
                return folder
    except OSError as error:
        raise UsageError(f"cannot make a folder for the run in {RUNS}: {error.strerror or error}") from None
    raise AssertionError  # itertools.count has no end


def run_of(journal: Path, header: Mapping[str, Any]) -> Path:
    """Return the folder of the run that contains a journal with this header."""
    if "side" in header:
        run = journal.parent
        of_certify = run.name == GAP and (run.parent / SIMULATION).is_dir()
        return run.parent if of_certify else run
    return journal.parent if journal.name in (SIMULATION, header.get("requirement")) else journal


def with_any(folder: Path, places: Sequence[str], is_run: Callable[[Path], bool]) -> Path:
    """Return the folder of a run, from that folder or that of one of its journals, at ``places`` in it."""
    up = (folder, *folder.absolute().parents[:2]) if is_run(folder) or folder.name == GAP else (folder,)
    return next((one for one in up if any(is_run(one / place) for place in places)), folder)


def places(folder: Path, requirements: Sequence[str], of: str | None) -> dict[str, Path]:
    """Return requirement → folder of its journal, for a run of ``s2r check``.

    ``folder`` is that of the run, or of the one requirement ``of`` whose journal lies in it.
    """
    if of is None:
        return {name: folder / name for name in requirements}
    if folder.absolute().name == of:
        return {name: folder.parent / name for name in requirements}
    return {name: folder if name == of else folder / name for name in requirements}


def runs_in(folder: Path) -> list[Path]:
    """Return the folders of the checks of single requirements: this folder or its subfolders; a UsageError if none."""
    if (folder / FILE).exists():
        return [folder]
    runs = sorted(path.parent for path in folder.glob(f"*/{FILE}"))
    if not runs:
        raise UsageError(f"no run in {folder}: neither it nor a subfolder has a {FILE}")
    return runs
