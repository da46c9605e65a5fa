"""A single sample far off, that one rollout has and most have not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import USUAL, Recordings, called

FloatArray = NDArray[np.float64]

FAR, MUCH = 20.0, 0.3
"""Tolerance: a sample is far off where it is so many times as far from its neighbours as any sample usually is, and by
this part of how much the channel moves. Twice as much misses spikes that are half as large."""


def spike(channel: Channel, of: Recordings) -> Finding | None:
    """Find the sample that is farthest off."""
    name, having = channel.name, of.measured(channel.name)
    if len(having) < 2:
        return None
    alone = [_alone(trace[name]) for _, _, trace in having]
    usual = np.quantile([each.max(axis=0) for each in alone], USUAL, axis=0)
    moves = np.median([np.ptp(trace[name].reshape(len(trace), -1), axis=0) for _, _, trace in having], axis=0)
    odd = [
        np.where((each > FAR * usual) & (each > MUCH * moves) & (moves > 0.0), each, 0.0).max(axis=1)
        for each in alone
    ]
    k = int(np.argmax([each.max() for each in odd]))
    sample = int(odd[k].argmax())
    if not odd[k][sample]:
        return None
    number, test, trace = having[k]
    text = (
        f"{name} of {called(number, test)} is off by {odd[k][sample]:.3g}"
        f"{f' {channel.unit}' if channel.unit else ''} for one sample at {trace.times[sample]:.4g} s, and in no other "
        f"rollout. Is it an error of the recording? If so, correct the sample, or leave the rollout out"
    )
    return Finding("spike", name, text)


def _alone(values: FloatArray) -> FloatArray:
    """Return (samples, columns) how far each sample is from both of its neighbours: 0 in a step or a slope."""
    wide = values.reshape(len(values), -1)
    away = np.zeros_like(wide)
    away[1:-1] = np.abs(wide[1:-1] - np.median([wide[:-2], wide[1:-1], wide[2:]], axis=0))
    return away
