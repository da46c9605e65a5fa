"""An angle that is kept within a turn, where the simulator's goes on."""

from __future__ import annotations

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.quality.suspects import PER_RADIAN
from s2r_spec.trace import Trace

NEARLY = 0.1
"""Tolerance: part of a turn by which a jump may be more or less. Twice as much takes fast motion for a jump."""


def wrapped(channel: Channel, of: Recordings) -> Finding | None:
    """Find an angle that jumps by a turn."""
    if channel.unit not in PER_RADIAN:
        return None
    turn = 2.0 * np.pi * PER_RADIAN[channel.unit]

    def jumps(trace: Trace) -> bool:
        steps = np.abs(np.diff(trace.channels.get(channel.name, np.zeros(0)), axis=0))
        return bool((np.abs(steps - turn) < NEARLY * turn).any())

    count = sum(jumps(trace) for _, trace in of.rollouts)
    if not count or any(jumps(simulated) for simulated, _ in of.pairs):
        return None
    text = (
        f"{channel.name} jumps by a full turn in {count} of {len(of.rollouts)} real rollouts, and the simulator's does "
        f"not. Unwrap it in the recordings, as numpy.unwrap does"
    )
    return Finding("wrapped", channel.name, text)
