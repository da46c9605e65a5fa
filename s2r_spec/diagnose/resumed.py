"""The folder and the seed of a diagnosis that is continued: its real rollouts are kept, the estimate is made again."""

from __future__ import annotations

import json
from pathlib import Path

from s2r_spec.base.errors import UsageError
from s2r_spec.diagnose.data.journal import CampaignJournal
from s2r_spec.runs.seeds import NEW_SEED, inherited_seed

REAL, ANSWER = "real", "diagnosis.json"
"""In the folder of a run: the folder of the real rollouts, and the file of the diagnosis."""


def begun_in(folder: Path) -> Path:
    """Return the folder of a diagnosis to continue, from that folder or from its folder of real rollouts.

    Raises:
        UsageError: nothing was recorded there.
    """
    run = folder.parent if folder.name == REAL and not (folder / REAL).exists() else folder
    real = run / REAL
    if not (run / ANSWER).exists() and not (real.is_dir() and any(real.iterdir())):
        raise UsageError(
            f"no run to resume in {folder}: there is no rollout in {real} and no {ANSWER}; begin a new run with --run"
        )
    return run


def seed_of(run: Path | None, seed: int | None) -> int:
    """Return the seed of a diagnosis.

    Args:
        run: the folder of the diagnosis to continue; None for a new one.
        seed: the seed that the user gave; None for that of the run, or of a new one.

    Raises:
        UsageError: the run has another seed.
    """
    recorded = None if run is None else _recorded_seed(run)
    if run is not None and recorded is not None:
        return inherited_seed(run, recorded, seed)
    return NEW_SEED if seed is None else seed


def _recorded_seed(run: Path) -> int | None:
    seed = CampaignJournal.seed_in(run / REAL)
    if seed is not None:
        return seed
    try:
        return int(json.loads((run / ANSWER).read_text(encoding="utf-8"))["provenance"]["seed"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
