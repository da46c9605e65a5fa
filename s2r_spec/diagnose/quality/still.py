"""A channel that never moves in the recordings, and always in the simulator."""

from __future__ import annotations

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Recordings


def still(channel: Channel, of: Recordings) -> Finding | None:
    """Find a channel that was perhaps not recorded; what is 0 or 1 may well not move."""
    name = channel.name
    pairs = of.paired(name)
    moved = [[np.ptp(trace[name], axis=0).max() for trace in pair] for pair in pairs]
    flag = any(np.isin(simulated[name], (0.0, 1.0)).all() for simulated, _ in pairs)
    if flag or not moved or not all(here > 0.0 == there for here, there in moved):
        return None
    text = f"{name} of the real rollouts never changes, and the simulator's does. Was it recorded? If not, leave it out"
    return Finding("still", name, text)
