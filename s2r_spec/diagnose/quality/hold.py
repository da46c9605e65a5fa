"""Samples that are held: a channel that keeps each value for several samples where the simulator's moves at every one.

It is read from the recordings alone. A held channel is also late by half of what it is held, so that the other checks
get recordings with straight lines between the samples at which it changes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import Rollout
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import listed
from s2r_spec.diagnose.simulate import Bench, blamed
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

LONGER = 2.0
"""Tolerance: times as long as the simulator's a value must be kept. Twice as much misses faster ones."""
REGULAR = 0.8
"""Tolerance: part of the values that are kept equally long; what is quantised is kept as long as its slope wants."""
SIZES = 4
"""Definition: different steps from one value to the next that a channel makes at least; a quantised one makes few."""
COMPARED = 3
"""Budget: rollouts that are compared. Twice as many cost as many more rollouts."""


def hold(bench: Bench, rollouts: Sequence[Rollout]) -> tuple[list[Finding], list[Rollout]]:
    """Return what is held, a finding for all channels that are held alike, and the rollouts without it."""
    ran = [(test, trace) for test, trace in rollouts if trace.failure is None and len(trace) > 2][:COMPARED]
    held: dict[str, float] = {}
    simulated: list[Trace] = []
    for channel in bench.backend.channels:
        name = channel.name
        periods = [_period(trace, name) for _, trace in ran]
        step = max((float(np.median(np.diff(trace.times))) for _, trace in ran), default=0.0)
        if not ran or min(periods) < 1.5 * step or max(periods) > 1.5 * min(periods):
            continue
        if not simulated:
            for test, _ in ran:
                with blamed(bench, {}, test, 0):
                    simulated.append(bench.run({}, test, 0))
        own = max(max(_kept(trace, name), float(np.median(np.diff(trace.times)))) for trace in simulated)
        if own > 0.0 and min(periods) > LONGER * own:
            held[name] = float(np.median(periods))
    if not held:
        return [], list(rollouts)
    names, seconds = list(held), float(np.median(list(held.values())))
    one = len(names) == 1
    text = (
        f"{listed(names)} of the real rollouts {'keeps' if one else 'keep'} each value for {seconds:.2g} s, while the "
        f"simulator's {'changes' if one else 'change'} at every sample. Was the last value repeated between slower "
        f"samples? If so, record {'it' if one else 'them'} as often as the rest"
    )
    straight = [(test, _straight(trace, names)) for test, trace in rollouts]
    return [Finding("hold", listed(names), text)], straight


def _changes(trace: Trace, name: str) -> NDArray[np.int64]:
    """Return the samples at which a channel has another value than before, the first included."""
    values = trace[name].reshape(len(trace), -1)
    return np.append(0, 1 + np.flatnonzero((np.diff(values, axis=0) != 0.0).any(axis=1)))


def _kept(trace: Trace, name: str) -> float:
    """Return the usual time [s] for which a channel keeps a value; 0 where it hardly moves, or is not there."""
    if name not in trace.channels:
        return 0.0
    at = _changes(trace, name)
    return float(np.median(np.diff(trace.times[at]))) if len(at) > 2 else 0.0


def _period(trace: Trace, name: str) -> float:
    """Return how long [s] a channel keeps each value; 0 where that is no one time, or its steps are of few sizes."""
    if name not in trace.channels or not np.isfinite(trace[name]).all():
        return 0.0
    at = _changes(trace, name)
    if len(at) < 2 * SIZES:
        return 0.0
    runs = np.diff(at)
    usual = float(np.median(runs))
    if (np.abs(runs - usual) <= 1.0).mean() < REGULAR:
        return 0.0
    steps = np.abs(np.diff(trace[name].reshape(len(trace), -1)[at], axis=0))
    sizes = max(len(np.unique(np.round(column / max(column.max(), 1e-300), 3))) for column in steps.T)
    return usual * float(np.median(np.diff(trace.times))) if sizes >= SIZES else 0.0


def _straight(trace: Trace, names: Sequence[str]) -> Trace:
    channels = dict(trace.channels)
    for name in names:
        if name in channels and np.isfinite(channels[name]).all():
            at = _changes(trace, name)
            columns = channels[name].reshape(len(trace), -1).T
            straight = [np.interp(trace.times, trace.times[at], column[at]) for column in columns]
            channels[name] = np.stack(straight, axis=1).reshape(channels[name].shape)
    return Trace(trace.times, channels, trace.units, trace.meta)
