"""The recordings, and a simulated rollout beside some of them: what the checks of single channels look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.simulate import Bench, Test
from s2r_spec.trace import Trace, between

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]
Pair = tuple[Trace, Trace]
"""A simulated rollout, and the real one of the same test."""

COMPARED = 5
"""Budget: rollouts that the simulator is run beside. Twice as many cost as many more rollouts."""
USUAL = 0.75
"""Level: part of the recordings that what is usual is true of. At twice the distance from 1, two of five may be odd."""


@dataclass(frozen=True, eq=False)
class Recordings:
    """What is checked.

    Attributes:
        bench: the simulator.
        rollouts: the machine's, in the order of their table.
    """

    bench: Bench
    rollouts: Sequence[Rollout]

    @cached_property
    def pairs(self) -> Sequence[Pair]:
        """The first rollouts that ended whole, beside the simulator's."""
        whole = [(test, trace) for test, trace in self.rollouts if trace.failure is None]
        return [(self.simulated(test), trace) for test, trace in whole[:COMPARED]]

    def simulated(self, test: Mapping[str, float]) -> Trace:
        """Return the simulator's rollout of a test."""
        return self.bench.run({}, test, 0)

    def paired(self, name: str) -> Sequence[Pair]:
        """Return the pairs; none where one of their traces lacks a channel."""
        return self.pairs if all(name in trace.channels for pair in self.pairs for trace in pair) else ()

    def measured(self, name: str) -> list[tuple[int, Test, Trace]]:
        """Return number, test and trace of the rollouts in which a channel is of measured numbers, no flag or count."""
        found: list[tuple[int, Test, Trace]] = []
        for number, (test, trace) in enumerate(self.rollouts):
            values = trace.channels.get(name, np.zeros(0))
            if len(values) > 2 and np.isfinite(values).all() and not (values == np.round(values)).all():
                found.append((number, test, trace))
        return found

    def factors(self, name: str) -> FloatArray:
        """Return (pairs,) how many times the simulator's each real one is; empty where one of the two is nothing."""
        sizes = np.array([(rms(here[name]), rms(there[name])) for here, there in self.paired(name)])
        return sizes[:, 1] / sizes[:, 0] if sizes.size and sizes.min() > 0.0 else np.zeros(0)


def called(number: int, test: Mapping[str, float]) -> str:
    """Return which real rollout it is, in words."""
    values = ", ".join(f"{name} = {value:.4g}" for name, value in test.items())
    return f"real rollout {number}" + (f" ({values})" if values else "")


def correlation(pair: Pair, name: str) -> float:
    """Return the correlation of a channel with the simulator's, at the times of the latter; 0 where nothing moves."""
    simulated, real = pair
    times, own = simulated.times - simulated.times[0], real.times - real.times[0]
    common = times <= own[-1]
    here, there = simulated[name], between(times, own, real[name])
    if here.shape != there.shape:
        return 0.0
    both = np.array([here[common].ravel(), there[common].ravel()])
    both = both[:, np.isfinite(both).all(axis=0)]
    return float(np.corrcoef(both)[0, 1]) if both.shape[1] > 1 and both.std(axis=1).all() else 0.0


def rms(values: FloatArray) -> float:
    """Return the root mean square of what is a number; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if known.size else 0.0
