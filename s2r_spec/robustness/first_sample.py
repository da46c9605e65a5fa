"""ρ at the first sample of a regular grid, from the samples that can reach it.

Model: ρ there depends on no sample past the formula's reach. Windows take minima and maxima, which round nothing, so
the samples up to the reach give the same number as all of them. But a predicate without a value, such as 0/0, is an
error of the whole trace wherever it is. So the rest of the trace may be left out only if every predicate has a value
there: its numbers are sums, products and functions of numbers with a known bound, and no bound overflows.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import reduce

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.horizon import samples_read
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.once import once
from s2r_spec.robustness.sampled import walk_samples
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
def _bound_of(signal: FloatArray) -> float:
    """Return the largest absolute value of a signal that does not change."""
    return float(np.max(np.abs(signal)))


def is_defined(formula: f.Formula, samples: SampledSignals) -> bool:
    """Return whether every predicate of a formula has a value at every sample, as far as bounds show."""
    bounds = _Bounds(samples)
    return all(max(bounds(one.left), bounds(one.right)) <= LARGEST for one in _predicates(formula))


@once
def _predicates(formula: f.Formula) -> tuple[f.Comparison, ...]:
    return tuple(node for node in f.walk(formula) if isinstance(node, f.Comparison))


class _Bounds:
    """Bounds of the absolute values of numbers over a trace; inf where there is none."""

    def __init__(self, samples: SampledSignals) -> None:
        self.samples = samples
        clock = samples.clock
        self.step = clock.step if isinstance(clock, Grid) else 0.0
        self.last = clock.seconds(clock.count - 1)
        self.widest = max((signal.shape[-2] for signal in samples.signals.values()), default=1)

    def __call__(self, node: f.Value) -> float:
        match node:
            case f.Number():
                return abs(node.value)
            case f.SignalValue():
                return _bound_of(self.samples.signals[node.name])
            case f.ParamValue():
                return float(np.max(np.abs(self.samples.params[node.name])))
            case f.Convert():
                factor, shift = node.conversion.factor, abs(float(node.conversion.shift))
                return _product(factor, self(node.operand)) + shift
            case f.Arithmetic():
                return self._arithmetic(node)
            case f.Elementary(function="sign"):
                return 1.0 if self(node.operand) <= LARGEST else math.inf
            case f.Elementary(function="minus" | "abs") | f.Initial() | f.Delayed():
                return self(node.operand)
            case f.Extremum() | f.Choice():
                parts = node.operands if isinstance(node, f.Extremum) else (node.left, node.right)
                return max(map(self, parts))
            case f.Norm():
                bounds = map(self, node.operands)
                return math.sqrt(sum(self.widest * _product(bound, bound) for bound in bounds))
            case f.Derivative() | f.Accumulated():
                return self._of_slopes(node)
            case f.Duration():
                return self.last
            case f.Count():
                return float(self.samples.clock.count)
            case f.Overshoot():
                return self(node.signal) + self(node.reference)
        return math.inf

    def _of_slopes(self, node: f.Derivative | f.Accumulated) -> float:
        values = self(node.operand)
        slopes = _product(values, 2.0 / self.step) if self.step else 0.0
        if isinstance(node, f.Derivative):
            return slopes
        total = _product(values, self.last)
        if max(slopes, total) > LARGEST:  # an integral and a mean have both on the way
            return math.inf
        return total if node.function == "integral" else values

    def _arithmetic(self, node: f.Arithmetic) -> float:
        left = self(node.left)
        match node.operator, node.right:
            case "+" | "-", right:
                return left + self(right)
            case "*", right:
                return _product(left, self(right))
            case "/", f.Number(value=value) if value:
                return left / abs(value)
            case "^", f.Number(value=2.0):
                return _product(left, left)
        return math.inf


def _product(left: float, right: float) -> float:
    """Return the bound of a product; with an infinite number it may be 0 · inf, which has no value."""
    return left * right if math.isfinite(left) and math.isfinite(right) else math.inf
