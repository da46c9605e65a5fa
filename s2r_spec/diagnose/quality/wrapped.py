"""An angle that is kept within a turn, where the simulator's goes on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.pairs import Pair
from s2r_spec.trace import Trace

TURNS, NEARLY = {"rad": 2.0 * np.pi, "deg": 360.0}, 0.1
"""By unit, what an angle jumps by where it is kept within a turn; by this part of it more or less."""


def wrapped(channel: Channel, real: Sequence[Trace], pairs: Sequence[Pair]) -> str:
    """Return what to say of an angle that jumps by a turn; "" for nothing."""
    turn = TURNS.get(channel.unit)
    if turn is None:
        return ""
    count = sum(_jumps(trace, channel.name, turn) for trace in real)
    if not count or any(_jumps(simulated, channel.name, turn) for simulated, _ in pairs):
        return ""
    return (
        f"{channel.name} jumps by a full turn in {count} of {len(real)} real rollouts, and the simulator's does not. "
        f"Unwrap it in the recordings, as numpy.unwrap does"
    )


def _jumps(trace: Trace, name: str, turn: float) -> bool:
    """Return whether an angle jumps by a turn from one sample to the next."""
    if name not in trace.channels:
        return False
    steps = np.abs(np.diff(trace[name], axis=0))
    return bool((np.abs(steps - turn) < NEARLY * turn).any())
