"""Robustness on samples: a condition is evaluated only at the samples.

Numbers are arrays of shape (…, width, n), conditions arrays of shape (…, n);
any batch axes come first, time is last.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Walk, Witness
from s2r_spec.robustness.kernels import shift
from s2r_spec.robustness.numbers import Numbers, SampleTimes, margin
from s2r_spec.robustness.ties import rescale

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


class SampleClock(SampleTimes, Protocol):
    """Sample times and windows on them: :class:`~s2r_spec.robustness.grid.Grid` or ``Ticks``."""

    def windows(self, interval: f.Interval, past: bool) -> tuple[IntArray, IntArray]:
        """Return (first, last), each (n,): the samples in the window of each sample; empty if last < first."""
        ...

    def always(self, x: FloatArray, interval: f.Interval, past: bool) -> FloatArray:
        """Return (…, n): the least of x in the window of each sample, +inf if it is empty."""
        ...

    def eventually(self, x: FloatArray, interval: f.Interval, past: bool) -> FloatArray:
        """Return (…, n): the greatest of x in the window of each sample, −inf if it is empty."""
        ...

    def until(self, left: FloatArray, right: FloatArray, interval: f.Interval, past: bool) -> FloatArray:
        """Return (…, n): see :func:`s2r_spec.robustness.kernels.until`."""
        ...


@dataclass(frozen=True)
class SampledSignals:
    """Sample times, signals and parameters on which formulas are evaluated.

    Args:
        clock: the sample times.
        signals: name → (…, width, n), in the declared unit, free of NaN.
        params: name → (…, 1, 1) numbers, in the declared unit.
        until: see :class:`s2r_spec.robustness.evaluate.Walk`.
    """

    clock: SampleClock
    signals: Mapping[str, FloatArray]
    params: Mapping[str, FloatArray]
    until: Witness = "open"


def walk_samples(samples: SampledSignals) -> Walk[FloatArray]:
    """Return the walk that evaluates a formula to (…, n), its robustness at every sample.

    Windows are cut at the ends of the trace (see :mod:`s2r_spec.robustness.kernels`).
    The walk raises TraceError if a time bound does not fit the sample times, or a
    predicate is undefined (0/0, √−1).
    """
    return Walk(SampledAlgebra(samples), samples.until)


def robustness(formula: f.Formula, samples: SampledSignals) -> FloatArray:
    """Return (…, n): the robustness of a formula at every sample; see :func:`walk_samples`."""
    return walk_samples(samples)(formula)


class SampledAlgebra:
    """Robustness signals as arrays (…, n)."""

    def __init__(self, samples: SampledSignals) -> None:
        self.samples = samples
        self.numbers = Numbers(samples.signals, samples.params, samples.clock, partial(walk_samples, samples))

    def truth(self, value: bool) -> FloatArray:
        """Return (n,) infinities."""
        return np.full(self.samples.clock.count, np.inf if value else -np.inf)

    def flag(self, node: f.Flag) -> FloatArray:
        """Return (…, n) infinities."""
        return np.where(self.samples.signals[node.name][..., 0, :] > 0, np.inf, -np.inf)

    def margin(self, node: f.Comparison) -> FloatArray:
        """Return (…, n): the margin of the comparison."""
        return margin(node, self.numbers, self.samples.clock)

    def negative(self, x: FloatArray) -> FloatArray:
        """Return −x."""
        return np.negative(x)

    def scale(self, x: FloatArray, factor: float) -> FloatArray:
        """Return factor · x."""
        return rescale(x, factor)

    def least(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the smaller of both."""
        return np.minimum(x, y)

    def greatest(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the greater of both."""
        return np.maximum(x, y)

    def always(self, x: FloatArray, interval: f.Interval, past: bool) -> FloatArray:
        """Return the least over the window."""
        return self.samples.clock.always(x, interval, past)

    def eventually(self, x: FloatArray, interval: f.Interval, past: bool) -> FloatArray:
        """Return the greatest over the window."""
        return self.samples.clock.eventually(x, interval, past)

    def until(self, left: FloatArray, right: FloatArray, interval: f.Interval, past: bool) -> FloatArray:
        """Return the robustness of the best witness."""
        return self.samples.clock.until(left, right, interval, past)

    def step(self, x: FloatArray, node: f.AdjacentSample) -> FloatArray:
        """Return the neighbouring sample's x."""
        return shift(x, 1 if node.operator == "next" else -1, -np.inf)

    def rise(self, x: FloatArray) -> FloatArray:
        """Return min(x, −x one sample before)."""
        return self.edge(x, x)

    def edge(self, now: FloatArray, before: FloatArray, earlier: float = np.inf) -> FloatArray:
        """Return min(now, −before one sample before); ``earlier`` is the value before the first one."""
        # it counts as true before the first sample, so there is no edge at the first one
        return np.minimum(now, np.negative(shift(before, -1, earlier)))
