"""A channel that is anticorrelated with the simulator's in every rollout: it may count the other way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.pairs import Pair, correlation, factors

LOUD = 5.0
"""A channel with the other sign is at most so many times the simulator's, or a part of it."""
OPPOSITE = -0.9
"""A channel whose correlation with the simulator's is below this in all of them has the other sign."""


def other_sign(channel: Channel, pairs: Sequence[Pair]) -> str:
    """Return what to say of a channel that goes the other way; "" for nothing."""
    name, times = channel.name, factors(channel.name, pairs)
    if not times or not 1.0 / LOUD < np.median(times) < LOUD:
        return ""
    if max(correlation(simulated, real, name) for simulated, real in pairs) >= OPPOSITE:
        return ""
    return f"{name} of the real rollouts has the opposite sign of the simulator's. Do both use one sign convention?"
