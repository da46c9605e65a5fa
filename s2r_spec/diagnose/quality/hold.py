"""Samples that are held: a channel that keeps each value for several samples where the simulator's moves at every one.

It is read from the recordings alone. A held channel is also late by half of what it is held, so that the other checks
get recordings with straight lines between the samples at which it changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.quality.suspects import listed
from s2r_spec.trace import Trace

LONGER = 2.0
"""Tolerance: times as long as the simulator's a value must be kept. Twice as much misses faster ones."""
REGULAR = 0.8
"""Level: part of the values that are kept equally long; what is quantised is kept as long as its slope wants. At twice
the distance from 1, quantised channels are held."""
SIZES = 4
"""Definition: different steps from one value to the next that a channel makes at least; a quantised one makes few."""


def hold(of: Recordings) -> tuple[list[Finding], Recordings]:
    """Return what is held, a finding for all channels that are held alike, and the recordings without it."""
    if not of.pairs:
        return [], of
    held: dict[str, float] = {}
    simulated, real = zip(*of.pairs, strict=True)
    step, own = max(map(_step, real)), max(map(_step, simulated))
    for channel in of.bench.backend.channels:
        seconds = [each if regular else 0.0 for each, regular in (_kept(one, channel.name) for one in real)]
        if min(seconds) < 1.5 * step or max(seconds) > 1.5 * min(seconds):
            continue
        if min(seconds) > LONGER * max(own, *(_kept(one, channel.name)[0] for one in simulated)):
            held[channel.name] = float(np.median(seconds))
    if not held:
        return [], of
    names, lasts = list(held), float(np.median(list(held.values())))
    one = len(names) == 1
    text = (
        f"{listed(names)} of the real rollouts {'keeps' if one else 'keep'} each value for {lasts:.2g} s, while the "
        f"simulator's {'changes' if one else 'change'} at every sample. Was the last value repeated between slower "
        f"samples? If so, record {'it' if one else 'them'} as often as the rest"
    )
    straight = [(test, _straight(trace, names)) for test, trace in of.rollouts]
    return [Finding("hold", listed(names), text)], replace(of, rollouts=straight)


def _step(trace: Trace) -> float:
    return float(np.median(np.diff(trace.times))) if len(trace) > 1 else 0.0


def _changes(wide: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the samples at which (samples, columns) values are others than before, the first included."""
    return np.append(0, 1 + np.flatnonzero((np.diff(wide, axis=0) != 0.0).any(axis=1)))


def _kept(trace: Trace, name: str) -> tuple[float, bool]:
    """Return how long [s] a channel usually keeps a value, 0 where it hardly moves, and whether that is one time.

    It is not where its steps are of few sizes.
    """
    values = trace.channels.get(name, np.zeros(1))
    wide = values.reshape(len(values), -1)
    at = _changes(wide)
    if len(at) <= 2 or not np.isfinite(wide).all():
        return 0.0, False
    runs = np.diff(at)
    usual = float(np.median(runs))
    steps = np.abs(np.diff(wide[at], axis=0))
    sizes = max(len(np.unique(np.round(column / max(column.max(), 1e-300), 3))) for column in steps.T)
    regular = len(at) >= 2 * SIZES and sizes >= SIZES and (np.abs(runs - usual) <= 1.0).mean() >= REGULAR
    return usual * _step(trace), bool(regular)


def _straight(trace: Trace, names: Sequence[str]) -> Trace:
    channels = dict(trace.channels)
    for name in names:
        if name in channels and np.isfinite(channels[name]).all():
            wide = channels[name].reshape(len(trace), -1)
            at = _changes(wide)
            straight = [np.interp(trace.times, trace.times[at], column[at]) for column in wide.T]
            channels[name] = np.stack(straight, axis=1).reshape(channels[name].shape)
    return replace(trace, channels=channels)
