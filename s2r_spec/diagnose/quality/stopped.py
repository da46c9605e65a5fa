"""A channel that stops in the middle of one rollout."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.pairs import called
from s2r_spec.diagnose.simulate import Bench, Test, blamed
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

HELD, LONGER = 0.2, 4.0
"""A channel has stopped where it keeps one value for this part of a rollout, so many times as long as in most."""
MOVES = 0.05
"""Part of its range that the simulator's moves by at that time."""
MOST = 0.75
"""Of the rollouts."""


def stopped(bench: Bench, name: str, having: Sequence[tuple[int, Test, Trace]]) -> str:
    """Return what to say of a channel that keeps one value for long in one rollout; "" for nothing."""
    held = [_longest(trace, name) for _, _, trace in having]
    usual = float(np.quantile([until - since for since, until, _ in held], MOST))
    k = int(np.argmax([until - since for since, until, _ in held]))
    number, test, trace = having[k]
    since, until, column = held[k]
    if until - since < max(HELD * trace.duration, LONGER * usual):
        return ""
    every = np.concatenate([_column(each, name, column) for _, _, each in having])
    if _column(trace, name, column)[trace.times - trace.times[0] >= since][0] in (every.min(), every.max()):
        return ""  # as what saturates does
    with blamed(bench, {}, test, 0):
        simulated = bench.run({}, test, 0)
    if name not in simulated.channels:
        return ""
    times, own = simulated.times - simulated.times[0], _column(simulated, name, column)
    there = own[(times >= since) & (times <= until)]
    if not len(there) or np.ptp(there) <= MOVES * np.ptp(own):
        return ""
    begin = float(trace.times[0])
    return (
        f"{name} of {called(number, test)} keeps one value from {begin + since:.4g} to {begin + until:.4g} s, while "
        f"the simulator's changes. Was it recorded all the time? If not, leave the rollout out"
    )


def _longest(trace: Trace, name: str) -> tuple[float, float, int]:
    """Return from when until when [s from the begin] a column of a channel keeps its value the longest, and which."""
    times, best = trace.times - trace.times[0], (0.0, 0.0, 0)
    for n in range(trace[name].reshape(len(trace), -1).shape[1]):
        values = _column(trace, name, n)
        changes = np.flatnonzero(np.diff(values) != 0.0)
        first, last = np.append(0, changes + 1), np.append(changes, len(values) - 1)
        k = int(np.argmax(times[last] - times[first]))
        if times[last[k]] - times[first[k]] > best[1] - best[0]:
            best = float(times[first[k]]), float(times[last[k]]), n
    return best


def _column(trace: Trace, name: str, column: int) -> FloatArray:
    return np.asarray(trace[name].reshape(len(trace), -1)[:, column])
