"""Real rollouts beside one simulated rollout of the same test each, and what several checks ask of such pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import Rollout
from s2r_spec.diagnose.simulate import Bench, blamed
from s2r_spec.trace import Trace, between

FloatArray = NDArray[np.float64]

Pair = tuple[Trace, Trace]
"""A simulated rollout, and the real one of the same test."""

COMPARED = 5
"""Rollouts that are compared with the simulator for it, at most."""


def simulated(bench: Bench, rollouts: Sequence[Rollout]) -> list[Pair]:
    """Return pairs of the first rollouts that ended whole, COMPARED at most."""
    pairs = []
    for test, trace in [(test, trace) for test, trace in rollouts if trace.failure is None][:COMPARED]:
        with blamed(bench, {}, test, 0):
            pairs.append((bench.run({}, test, 0), trace))
    return pairs


def called(number: int, test: Mapping[str, float]) -> str:
    """Return which real rollout it is, in words."""
    values = ", ".join(f"{name} = {value:.4g}" for name, value in test.items())
    return f"real rollout {number}" + (f" ({values})" if values else "")


def factors(name: str, pairs: Sequence[Pair]) -> list[float]:
    """Return how many times the simulator's each real one is; nothing where one of the two is nothing, or is not."""
    if not all(name in trace.channels for pair in pairs for trace in pair):
        return []
    sizes = [(rms(simulated[name]), rms(real[name])) for simulated, real in pairs]
    return [there / here for here, there in sizes] if all(min(both) > 0.0 for both in sizes) else []


def correlation(simulated: Trace, real: Trace, name: str) -> float:
    """Return the correlation of a channel with the simulator's, at the times of the latter; 0 where nothing moves."""
    times, own = simulated.times - simulated.times[0], real.times - real.times[0]
    common = times <= own[-1]
    here, there = simulated[name], between(times, own, real[name])
    if here.shape != there.shape:
        return 0.0
    both = np.array([here[common].ravel(), there[common].ravel()])
    both = both[:, np.isfinite(both).all(axis=0)]
    if both.shape[1] < 2 or not both.std(axis=1).all():
        return 0.0
    return float(np.corrcoef(both)[0, 1])


def rms(values: FloatArray) -> float:
    """Return the root mean square of what is a number; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if known.size else 0.0
