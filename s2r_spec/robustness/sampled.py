"""Robustness on samples: a condition is evaluated only at the samples.

Numbers are arrays of shape (…, width, n), conditions arrays of shape (…, n);
any batch axes come first, time is last.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Walk, WithEdges
from s2r_spec.robustness.kernels import shift
from s2r_spec.robustness.numbers import Numbers, SampledSignals, margin
from s2r_spec.robustness.ties import rescale

FloatArray = NDArray[np.float64]


def walk_samples(samples: SampledSignals) -> Walk[FloatArray]:
    """Return the walk that evaluates a formula to (…, n), its robustness at every sample.

    It cuts windows at the ends of the trace, and raises TraceError if a time bound does not fit the sample times, or a
    predicate is undefined (0/0, √−1).
    """
    return Walk(SampledAlgebra(samples), samples.until)


class SampledAlgebra(WithEdges[FloatArray]):
    """Robustness signals as arrays (…, n)."""

    def __init__(self, samples: SampledSignals) -> None:
        self.samples = samples
        self.numbers = Numbers(samples, partial(walk_samples, samples))

    def truth(self, value: bool) -> FloatArray:
        """Return (n,) infinities."""
        return np.full(self.samples.clock.count, np.inf if value else -np.inf)

    def flag(self, node: f.Flag) -> FloatArray:
        """Return (…, n) infinities."""
        return np.where(self.samples.signals[node.name][..., 0, :] > 0, np.inf, -np.inf)

    def margin(self, node: f.Comparison) -> FloatArray:
        """Return (…, n): the margin of the comparison."""
        return margin(node, self.numbers)

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

    def edge(self, now: FloatArray, before: FloatArray, earlier: float = np.inf) -> FloatArray:
        """Return min(now, −before one sample before); ``earlier`` is the value before the first one."""
        # it counts as true before the first sample, so there is no edge at the first one
        return np.minimum(now, np.negative(shift(before, -1, earlier)))
