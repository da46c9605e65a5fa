"""One seed per rollout, from its place in the run and from nothing else."""

from __future__ import annotations

import numpy as np


def rollout_seed(seed: int, query: int, replicate: int) -> int:
    """Return the 64-bit seed of one rollout; worker count and order of completion do not enter."""
    return int(np.random.SeedSequence(seed, spawn_key=(query, replicate)).generate_state(1, np.uint64)[0])
