"""Samples that look like the recording's doing: single ones far off, and a channel that stops in the middle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.misread import called
from s2r_spec.diagnose.simulate import Bench, Test, blamed
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]

FAR, MUCH = 20.0, 0.3
"""A single sample is far off where it is so many times as far from its neighbours as any sample is in most rollouts,
and by this part of how much the channel moves."""
HELD, LONGER = 0.2, 4.0
"""A channel has stopped where it keeps one value for this part of a rollout, so many times as long as in most."""
MOVES = 0.05
"""Part of its range that the simulator's moves by at that time."""
MOST = 0.75
"""Of the rollouts."""


def glitches(bench: Bench, rollouts: Sequence[Rollout]) -> dict[str, str]:
    """Return what to say of each channel with samples that one rollout has and most have not.

    Args:
        bench: the simulator; it is run once at a test at which a channel seems to have stopped.
        rollouts: the machine's.
    """
    found = {}
    for channel in bench.backend.channels:
        name = channel.name
        having = [(n, test, trace) for n, (test, trace) in enumerate(rollouts) if _read(trace, name)]
        if len(having) < 2:
            continue
        if words := _far_off(name, having, channel.unit) or _stopped(bench, name, having):
            found[name] = words
    return found


def _read(trace: Trace, name: str) -> bool:
    """Return whether a trace has a channel of measured numbers: neither a flag nor a count."""
    if name not in trace.channels or len(trace) < 3:
        return False
    values = trace[name]
    return bool(np.isfinite(values).all()) and not (values == np.round(values)).all()


def _far_off(name: str, having: Sequence[tuple[int, Test, Trace]], unit: str) -> str:
    alone = [_alone(trace[name]) for _, _, trace in having]
    usual = np.quantile([each.max(axis=0) for each in alone], MOST, axis=0)
    moves = np.median([np.ptp(trace[name], axis=0) for _, _, trace in having], axis=0)
    worst, where = 0.0, (0, 0)
    for k, each in enumerate(alone):
        odd = np.where((each > FAR * usual) & (each > MUCH * moves) & (moves > 0.0), each, 0.0)
        sample = int(np.argmax(odd.max(axis=-1) if odd.ndim > 1 else odd))
        if (size := float(odd[sample].max())) > worst:
            worst, where = size, (k, sample)
    if not worst:
        return ""
    number, test, trace = having[where[0]]
    return (
        f"{name} of {called(number, test)} is off by {worst:.3g}{f' {unit}' if unit else ''} for a sample at "
        f"{trace.times[where[1]]:.4g} s, and is not so in the others: is that the recording? If so, mend the sample, "
        f"or leave the rollout out"
    )


def _alone(values: FloatArray) -> FloatArray:
    """Return how far each sample is from both of its neighbours, same shape: 0 in a step or a slope."""
    wide = values.reshape(len(values), -1)
    middle = np.median([wide[:-2], wide[1:-1], wide[2:]], axis=0)
    away = np.zeros_like(wide)
    away[1:-1] = np.abs(wide[1:-1] - middle)
    return np.asarray(away.reshape(values.shape))


def _stopped(bench: Bench, name: str, having: Sequence[tuple[int, Test, Trace]]) -> str:
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
        f"{name} of {called(number, test)} keeps one value from {begin + since:.4g} to {begin + until:.4g} s, where "
        f"the simulator's moves: was it recorded all the time? If not, leave the rollout out"
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
