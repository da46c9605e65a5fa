"""One seed per rollout, a function of only the run's seed and the rollout's query and replicate."""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path

import numpy as np

from s2r_spec.base.errors import UsageError

NEW_SEED = 0
"""Definition: the seed of a new run if the user gives none."""


class SeedStream(IntEnum):
    """Purpose of a rollout: rollouts of different streams share no randomness."""

    CHECK = 0
    GAP_SIM = 1
    GAP_REAL = 2
    FORETELL = 3
    REMAINDER = 4
    NOMINAL = 5
    PILOT = 6
    PILOT_REAL = 7


def rollout_seed(seed: int, query: int, replicate: int, stream: SeedStream = SeedStream.CHECK) -> int:
    """Return the 64-bit seed of one rollout; it does not depend on the number of workers or on their order."""
    key = (query, replicate) if stream is SeedStream.CHECK else (int(stream), query, replicate)
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1, np.uint64)[0])


def inherited_seed(folder: Path, recorded: int, seed: int | None) -> int:
    """Return the recorded seed of a run that is resumed; a UsageError refuses another one of the user."""
    if seed not in (None, recorded):
        raise UsageError(
            f"the run in {folder} has the seed {recorded}, not {seed}; leave out the seed, or begin a new run"
        )
    return recorded
