"""A channel that stops in the middle of one rollout."""

from __future__ import annotations

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import USUAL, Recordings, called
from s2r_spec.trace import Trace

HELD, LONGER = 0.2, 4.0
"""Tolerance: a channel has stopped where it keeps one value for this part of a rollout, so many times as long as is
usual. Twice as much misses shorter stops."""
MOVES = 0.05
"""Tolerance: part of its range that the simulator's moves by at that time. Twice as much misses stops while little
happens."""


def stopped(channel: Channel, of: Recordings) -> Finding | None:
    """Find a channel that keeps one value for long in one rollout."""
    name, having = channel.name, of.measured(channel.name)
    if len(having) < 2:
        return None
    held = [_longest(trace, name) for _, _, trace in having]
    lasts = [until - since for since, until, _ in held]
    k = int(np.argmax(lasts))
    number, test, trace = having[k]
    since, until, column = held[k]
    if lasts[k] < max(HELD * trace.duration, LONGER * float(np.quantile(lasts, USUAL))):
        return None
    every = np.concatenate([each[name].reshape(len(each), -1)[:, column] for _, _, each in having])
    times, own = trace.times - trace.times[0], trace[name].reshape(len(trace), -1)[:, column]
    if own[times >= since][0] in (every.min(), every.max()):
        return None  # as what saturates does
    simulated = of.simulated(test)
    if name not in simulated.channels:
        return None
    times, own = simulated.times - simulated.times[0], simulated[name].reshape(len(simulated), -1)[:, column]
    there = own[(times >= since) & (times <= until)]
    if not len(there) or np.ptp(there) <= MOVES * np.ptp(own):
        return None
    begin = float(trace.times[0])
    text = (
        f"{name} of {called(number, test)} keeps one value from {begin + since:.4g} to {begin + until:.4g} s, while "
        f"the simulator's changes. Was it recorded all the time? If not, leave the rollout out"
    )
    return Finding("stopped", name, text)


def _longest(trace: Trace, name: str) -> tuple[float, float, int]:
    """Return from when until when [s from the begin] a column of a channel keeps its value the longest, and which."""
    times, best = trace.times - trace.times[0], (0.0, 0.0, 0)
    for column, values in enumerate(trace[name].reshape(len(trace), -1).T):
        changes = np.flatnonzero(np.diff(values))
        first, last = times[np.append(0, changes + 1)], times[np.append(changes, len(values) - 1)]
        k = int(np.argmax(last - first))
        best = max(best, (float(first[k]), float(last[k]), column), key=lambda one: one[1] - one[0])
    return best
