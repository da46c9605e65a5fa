"""Robustness on samples: a condition is evaluated only at the samples.

Numbers are arrays of shape (…, width, n), conditions arrays of shape (…, n);
any batch axes come first, time is last.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.robustness.evaluate import Algebra, Walk
from s2r_spec.robustness.kernels import shift
from s2r_spec.robustness.numbers import Numbers, SampledSignals, margin
from s2r_spec.robustness.ties import rescale


def numbers_at(samples: SampledSignals) -> Numbers:
    """Return the numbers at the samples."""
    return Numbers(samples, partial(walk_samples, samples))


def walk_samples(samples: SampledSignals) -> Walk[FloatArray]:
    """Return the walk that evaluates a formula to (…, n), its robustness at every sample.

    It cuts windows at the ends of the trace, and raises TraceError if a time bound does not fit the sample times, or a
    predicate is undefined (0/0, √−1).
    """
    return Walk(sampled_algebra(numbers_at(samples)), samples.until)


def sampled_algebra(numbers: Numbers) -> Algebra[FloatArray]:
    """Return the operations on robustness signals as arrays (…, n)."""
    clock = numbers.clock

    def edge(now: FloatArray, before: FloatArray, earlier: float) -> FloatArray:
        # it counts as true before the first sample, so there is no edge at the first one
        return np.minimum(now, np.negative(shift(before, -1, earlier)))

    return Algebra(
        truth=lambda value: np.full(clock.count, np.inf if value else -np.inf),
        flag=lambda node: np.where(numbers.signals[node.name][..., 0, :] > 0, np.inf, -np.inf),
        margin=lambda node: margin(node, numbers),
        negative=np.negative,
        scale=rescale,
        least=np.minimum,
        greatest=np.maximum,
        always=clock.always,
        eventually=clock.eventually,
        until=clock.until,
        step=lambda x, node: shift(x, 1 if node.operator == "next" else -1, -np.inf),
        edge=edge,
    )
