"""The numbers that a predicate compares, at every sample."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.lang import formula as f
from s2r_spec.robustness import history
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.ticks import Clock
from s2r_spec.robustness.ties import break_ties


@dataclass(frozen=True)
class SampledSignals:
    """Sample times, signals and parameters on which formulas are evaluated.

    Args:
        clock: the sample times.
        signals: name → (…, width, n), in the declared unit, free of NaN.
        params: name → (…, 1, 1) numbers, in the declared unit.
        until: see :class:`s2r_spec.robustness.evaluate.Walk`.
    """

    clock: Clock
    signals: Mapping[str, FloatArray]
    params: Mapping[str, FloatArray]
    until: Witness = "open"


class Numbers:
    """Evaluates values to (…, width, n); a value that is constant over time has n = 1.

    Args:
        samples: the signals and parameters.
        conditions: a function that makes the evaluator of conditions in ``if``, ``duration`` and ``count``, to (…, n).
    """

    def __init__(
        self, samples: SampledSignals, conditions: Callable[[], Callable[[f.Formula], FloatArray]]
    ) -> None:
        self.signals, self.params, self.clock = samples.signals, samples.params, samples.clock
        # never the walk of these numbers: a reference cycle would keep the samples in memory
        # until the garbage collector runs
        self.conditions = conditions
        self.formula: Callable[[f.Formula], FloatArray] | None = None
        self.done: dict[int, FloatArray] = {}

    def __call__(self, node: f.Value) -> FloatArray:
        """Return (…, width, n) or (…, width, 1); NaN where the value is undefined."""
        if id(node) not in self.done:
            self.done[id(node)] = self._value(node)
        return self.done[id(node)]

    def _value(self, node: f.Value) -> FloatArray:
        match node:
            case f.Number():
                return np.array([[node.value]])
            case f.SignalValue():
                signal = self.signals[node.name]
                return signal if node.index is None else signal[..., node.index : node.index + 1, :]
            case f.ParamValue():
                return self.params[node.name]
            case _:
                # margin reports an undefined result with its predicate
                with np.errstate(all="ignore"):
                    return self._compute(node)

    def _compute(self, node: f.Value) -> FloatArray:
        match node:
            case f.Initial():
                return self(node.operand)[..., :1]
            case f.Overshoot():
                return (self(node.signal) - self(node.reference)) * self.direction(node)
            case f.Convert():
                return node.conversion.each(self(node.operand))
            case f.Arithmetic():
                result: FloatArray = ARITHMETIC[node.operator](self(node.left), self(node.right))
                return result
            case f.Elementary():
                return _ELEMENTARY[node.function](self(node.operand))
            case f.Extremum():
                return reduce(np.minimum if node.function == "min" else np.maximum, map(self, node.operands))
            case f.Choice():
                return np.where(self.holds(node.condition), self(node.left), self(node.right))
            case f.Delayed() | f.Derivative() | f.Accumulated() | f.Duration() | f.Count():
                return self._history(node)
            case f.Norm():
                squares = (np.sum(np.square(self(part)), axis=-2, keepdims=True) for part in node.operands)
                return np.sqrt(sum(squares, start=np.zeros((1, 1))))
            case _:
                raise AssertionError(node)

    def holds(self, node: f.Formula) -> BoolArray:
        """Return (…, 1, n): where a condition holds."""
        if self.formula is None:
            self.formula = self.conditions()
        return np.asarray(self.formula(node) > 0)[..., np.newaxis, :]

    def _history(self, node: f.Value) -> FloatArray:
        times, snap = self.clock.times, self.clock.snap
        match node:
            case f.Duration():
                return history.duration(self.holds(node.operand), times)
            case f.Count():
                return history.count(self.holds(node.operand), times, node.seconds, snap)
            case f.Delayed():
                return history.delay(self._along(node.operand), times, node.seconds, snap)
            case f.Derivative():
                return history.derivative(self._along(node.operand), times)
            case f.Accumulated():
                over = history.integral if node.function == "integral" else history.mean
                return over(self._along(node.operand), times, node.seconds)
            case _:
                raise AssertionError(node)

    def _along(self, node: f.Value) -> FloatArray:
        """Return (…, width, n), also of a constant."""
        values = self(node)
        return np.broadcast_to(values, (*values.shape[:-1], self.clock.count))

    def direction(self, node: f.Overshoot) -> FloatArray:
        """Return (…, 1, 1): +1 or −1, the direction of a motion, which the first sample determines."""
        origin = 0.0 if node.origin is None else self(node.origin)[..., :1]
        return np.where(self(node.reference)[..., :1] >= origin, 1.0, -1.0)


def margin(node: f.Comparison, numbers: Numbers) -> FloatArray:
    """Return (…, n): the margin of a comparison, never 0; see :mod:`s2r_spec.robustness.ties`.

    Raises:
        TraceError: it is undefined at some sample.
    """
    left, right = numbers(node.left)[..., 0, :], numbers(node.right)[..., 0, :]
    clock = numbers.clock
    with np.errstate(invalid="ignore", over="ignore"):
        result: FloatArray = MARGIN[node.operator](left, right)
        least = np.minimum.reduce(result, axis=None, initial=np.inf)  # NaN if there is any
    result = break_ties(result, node.operator)
    if result.shape[-1] != clock.count:
        result = np.broadcast_to(result, (*result.shape[:-1], clock.count))
    if math.isnan(least):
        sample = int(np.argwhere(np.isnan(result))[0][-1])
        raise no_value(node, clock.place(sample))
    return result


def no_value(node: f.Comparison, where: str) -> TraceError:
    """Return the error of a predicate that is undefined."""
    return TraceError(
        f"`{node.span.text}` ({node.span.place}) has no value at {where}: a division by zero, "
        f"the root of a negative number, or a difference of infinities"
    )


MARGIN: Mapping[str, Callable[[Any, Any], Any]] = {
    "<": lambda x, y: y - x, "<=": lambda x, y: y - x, ">": lambda x, y: x - y, ">=": lambda x, y: x - y,
    "==": lambda x, y: -abs(x - y), "!=": lambda x, y: abs(x - y),
}  # fmt: skip
"""Comparison → the margin of two numbers, arrays or tensors."""
ARITHMETIC: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "^": operator.pow,
}  # fmt: skip
"""Operator → the result of two numbers, arrays or tensors."""
_ELEMENTARY = {"minus": np.negative, "abs": np.abs, "sign": np.sign, "sqrt": np.sqrt}
