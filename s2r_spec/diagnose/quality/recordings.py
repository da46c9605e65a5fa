"""The recordings, and a simulated rollout beside some of them: what the checks of single channels look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.data.space_filling import TESTS
from s2r_spec.diagnose.simulator.bench import Bench, TestRun
from s2r_spec.space import Key, key_of
from s2r_spec.trace import Trace

Pair = tuple[Trace, Trace]
"""A simulated rollout, and the real one of the same test."""


@dataclass(frozen=True, eq=False)
class Recordings:
    """What is checked: rollouts of the machine, in the order of their table, and the simulator."""

    bench: Bench
    rollouts: Sequence[TestRun]
    _simulated: dict[Key, Trace] = field(default_factory=dict)

    @cached_property
    def pairs(self) -> Sequence[Pair]:
        """The first rollouts that ended whole, beside the simulator's."""
        whole = [(test, trace) for test, trace in self.rollouts if trace.failure is None]
        return [(self.simulated(test), trace) for test, trace in whole[:TESTS]]

    @cached_property
    def samples(self) -> int:
        """Number of values of all channels in all rollouts."""
        return sum(values.size for _, trace in self.rollouts for values in trace.channels.values())

    def simulated(self, test: Mapping[str, float]) -> Trace:
        """Return the simulator's rollout of a test."""
        key = key_of(test)
        if key not in self._simulated:
            self._simulated[key] = self.bench.run({}, test, 0)
        return self._simulated[key]

    def paired(self, name: str) -> Sequence[Pair]:
        """Return the pairs; none where one of their traces lacks a channel."""
        return self.pairs if all(name in trace.channels for pair in self.pairs for trace in pair) else ()


def as_columns(trace: Trace, name: str) -> FloatArray:
    """Return (samples, columns) of a channel; (samples, 0) where the trace lacks it."""
    return trace.channels.get(name, np.zeros((len(trace), 0))).reshape(len(trace), -1)


def rms(values: FloatArray) -> float:
    """Return the root mean square of what is a number; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if known.size else 0.0
