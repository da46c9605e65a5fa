"""Where the journals of a run lie, and which folder ``--resume`` is given.

s2r check      RUN/<requirement>
s2r gap        RUN/sim  RUN/real
s2r certify    RUN/simulation  RUN/gap/sim  RUN/gap/real
from Python    the folder that ``check`` and ``check_measure`` were given
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

SIDES = ("sim", "real")
"""Folders of the journals of both sides of a gap."""
SIMULATION, GAP = "simulation", "gap"
"""Folders of the two searches of ``s2r certify``."""


def run_of(journal: Path, header: Mapping[str, Any]) -> Path:
    """Return the folder of the run that a journal's folder is part of.

    Args:
        journal: the folder that the journal is in.
        header: of the journal.
    """
    if "side" in header:
        run = journal.parent
        of_certify = run.name == GAP and (run.parent / SIMULATION).is_dir()
        return run.parent if of_certify else run
    return journal.parent if journal.name in (SIMULATION, header.get("requirement")) else journal


def with_any(folder: Path, places: Sequence[str], is_run: Callable[[Path], bool]) -> Path:
    """Return the folder of a whole run, for that or for the folder of one of its journals.

    Args:
        folder: that somebody gave.
        places: where the journals of such a run lie in its folder.
        is_run: whether a journal is in a folder.
    """
    up = (folder, *folder.absolute().parents[:2]) if is_run(folder) or folder.name == GAP else (folder,)
    return next((one for one in up if any(is_run(one / place) for place in places)), folder)


def places(folder: Path, requirements: Sequence[str], of: str | None) -> dict[str, Path]:
    """Return requirement → folder of its journal in a check's run.

    Args:
        folder: of the run, or of one requirement in it.
        requirements: those that are checked.
        of: the requirement whose journal lies in the folder itself; None if there is none.
    """
    if of is None:
        return {name: folder / name for name in requirements}
    if folder.absolute().name == of:
        return {name: folder.parent / name for name in requirements}
    return {name: folder if name == of else folder / name for name in requirements}
