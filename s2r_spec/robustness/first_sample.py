"""ρ at the first sample of a regular grid, from the samples that can reach it.

Model: ρ there depends on no sample past the formula's reach. Windows take minima and maxima, which round nothing, so
the samples up to the reach give the same number as all of them. But a predicate without a value, such as 0/0, is an
error of the whole trace wherever it is. So the rest of the trace may be left out only if every predicate has a value
there: its numbers are sums, products and functions of numbers with a known bound, and no bound overflows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.lang import formula as f
from s2r_spec.robustness.binding import names
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.horizon import samples_read
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.once import once
from s2r_spec.robustness.online.spans import Span, Spans
from s2r_spec.robustness.sampled import walk_samples
from s2r_spec.robustness.ticks import Clock
from s2r_spec.robustness.ties import rescale_number

LARGEST = 1e300
"""Tolerance: bound up to which a sum of two numbers does not overflow."""


def rho_at_first_sample(formula: f.Formula, samples: SampledSignals) -> float:
    """Return ρ at the first sample, never 0: its sign is the verdict.

    Args:
        formula: a checked formula with numbers for its time bounds.
        samples: signals of shape (width, n).

    Raises:
        TraceError: a time bound does not fit the sample times, or a predicate is undefined at some sample.
    """
    if isinstance(samples.clock, Grid) and is_defined(formula, samples):
        try:
            return _least(formula, walk_samples(_reached(formula, samples)), samples.clock)
        except TraceError:
            pass  # several windows may not fit: all samples give the error of the first one
    return float(walk_samples(samples)(formula)[0])


def _reached(formula: f.Formula, samples: SampledSignals) -> SampledSignals:
    """Return the samples that a formula reads at the first one; two at least, for a derivative."""
    clock = samples.clock
    assert isinstance(clock, Grid)
    count = max(samples_read(formula, clock.period) + 1, 2)
    if count >= clock.count:
        return samples
    signals = {name: signal[..., : int(count)] for name, signal in samples.signals.items()}
    return replace(samples, clock=replace(clock, count=int(count)), signals=signals)


def _least(node: f.Formula, walk: Walk[FloatArray], grid: Grid) -> float:
    """Return ρ of a node at the first sample; a window there needs one extreme, and no curve of extremes."""
    match node:
        case f.Named():
            return _least(node.operand, walk, grid)
        case f.Not():
            return -_least(node.operand, walk, grid)
        case f.Rescale():
            return rescale_number(_least(node.operand, walk, grid), node.factor)
        case f.Junction():
            fold = min if node.operator == "and" else max
            return fold(_least(part, walk, grid) for part in node.operands)
        case f.Implication(operator="->"):
            return max(-_least(node.left, walk, grid), _least(node.right, walk, grid))
        case f.Temporal(operator="always"):
            low, high = grid.window(node.interval)
            return _over(np.minimum, np.inf, "and", node.operand, walk, (low, high))
        case f.Temporal(operator="eventually"):
            low, high = grid.window(node.interval)
            return _over(np.maximum, -np.inf, "or", node.operand, walk, (low, high))
    return float(walk(node)[0])


def _over(
    fold: np.ufunc,
    empty: float,
    operator: str,
    node: f.Formula,
    walk: Walk[FloatArray],
    window: tuple[int, int | None],
) -> float:
    """Return the extreme of a node over the samples of a window."""
    if isinstance(node, f.Junction) and node.operator == operator:
        return reduce(fold, (_over(fold, empty, operator, part, walk, window) for part in node.operands))
    low, high = window
    inside = walk(node)[low:] if high is None else walk(node)[low : high + 1]
    return float(fold.reduce(inside, initial=empty))


@once
def _range_of(signal: FloatArray) -> Span:
    """Return the least and the largest value of a signal that does not change."""
    return float(signal.min()), float(signal.max())


def is_defined(formula: f.Formula, samples: SampledSignals) -> bool:
    """Return whether every predicate of a formula has a value at every sample, as far as bounds show."""
    ranges = {name: _range_of(samples.signals[name]) for name in names(formula).signals}
    params = {name: float(samples.params[name].item()) for name in names(formula).params}
    bounds = _Bounds(ranges, params, lambda node: None, samples.clock)
    try:
        return all(map(bounds, (side for one in _predicates(formula) for side in (one.left, one.right))))
    except _UnboundedError:
        return False


@once
def _predicates(formula: f.Formula) -> tuple[f.Comparison, ...]:
    return tuple(node for node in f.walk(formula) if isinstance(node, f.Comparison))


class _UnboundedError(Exception):
    """A number may have no value, or no known bound."""


@dataclass(eq=False)
class _Bounds(Spans):
    """Spans of numbers over a whole trace.

    Raises:
        _UnboundedError: a number on the way is beyond ``LARGEST``, or may be undefined.
    """

    clock: Clock

    def _spans(self, node: f.Value) -> tuple[Span, ...]:
        spans = self._over_trace(node)
        if not all(abs(end) <= LARGEST for span in spans for end in span):
            raise _UnboundedError
        return spans

    def _over_trace(self, node: f.Value) -> tuple[Span, ...]:
        clock, last = self.clock, self.clock.seconds(self.clock.count - 1)
        match node:
            case f.Duration():
                return ((0.0, last),)
            case f.Count():
                return ((0.0, float(clock.count)),)
            case f.Derivative() | f.Accumulated():
                spans = self(node.operand)
                size = max(abs(end) for span in spans for end in span)
                slope = 2.0 * size / clock.step if isinstance(clock, Grid) and clock.step else 0.0
                if isinstance(node, f.Derivative):
                    return ((-slope, slope),) * len(spans)
                if max(slope, size * last) > LARGEST:  # an integral and a mean have both on the way
                    raise _UnboundedError
                return spans if node.function == "mean" else ((-size * last, size * last),) * len(spans)
            case f.Elementary(function="sqrt") if self(node.operand)[0][0] < 0.0:
                raise _UnboundedError
            case f.Arithmetic(operator="^") if self(node.right)[0] != (2.0, 2.0):
                raise _UnboundedError
            case _:
                return super()._spans(node)
