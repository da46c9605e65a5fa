"""A channel that never moves in the recordings, and always in the simulator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.diagnose.quality.pairs import Pair


def still(name: str, pairs: Sequence[Pair]) -> str:
    """Return what to say of a channel that was perhaps not recorded; "" for nothing."""
    if not _still(name, pairs):
        return ""
    return f"{name} of the real rollouts never changes, and the simulator's does. Was it recorded? If not, leave it out"


def _still(name: str, pairs: Sequence[Pair]) -> bool:
    """Return whether a channel moves in every simulated rollout, and in no real one; what is 0 or 1 may well not."""
    if not all(name in trace.channels for pair in pairs for trace in pair):
        return False
    moved = [[float(np.ptp(trace[name], axis=0).max()) for trace in pair] for pair in pairs]
    flag = any(np.isin(simulated[name], (0.0, 1.0)).all() for simulated, _ in pairs)
    return not flag and all(here > 0.0 and there == 0.0 for here, there in moved)
