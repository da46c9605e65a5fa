"""A single sample far off, that one rollout has and most have not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.pairs import called
from s2r_spec.diagnose.simulate import Test
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

FAR, MUCH = 20.0, 0.3
"""A single sample is far off where it is so many times as far from its neighbours as any sample is in most rollouts,
and by this part of how much the channel moves."""
MOST = 0.75
"""Of the rollouts."""


def spike(name: str, having: Sequence[tuple[int, Test, Trace]], unit: str) -> str:
    """Return what to say of the sample that is farthest off; "" for nothing."""
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
        f"{name} of {called(number, test)} is off by {worst:.3g}{f' {unit}' if unit else ''} for one sample at "
        f"{trace.times[where[1]]:.4g} s, and in no other rollout. Is it an error of the recording? If so, correct the "
        f"sample, or leave the rollout out"
    )


def _alone(values: FloatArray) -> FloatArray:
    """Return how far each sample is from both of its neighbours, same shape: 0 in a step or a slope."""
    wide = values.reshape(len(values), -1)
    middle = np.median([wide[:-2], wide[1:-1], wide[2:]], axis=0)
    away = np.zeros_like(wide)
    away[1:-1] = np.abs(wide[1:-1] - middle)
    return np.asarray(away.reshape(values.shape))
