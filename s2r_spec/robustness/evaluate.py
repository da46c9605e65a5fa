"""Robustness of a checked formula on samples: a walk over its nodes.

Numbers are arrays of shape (…, width, n), conditions arrays of shape (…, n);
any batch axes come first, time is last.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError
from s2r_spec.lang import formula as f
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.kernels import shift, until, window_max, window_min

FloatArray = NDArray[np.float64]
Witness = Literal["open", "closed"]


@dataclass(frozen=True)
class Samples:
    """What a formula is evaluated on.

    Args:
        grid: the sample times.
        signals: name → (…, width, n), in the declared unit, free of NaN.
        params: name → a number, or (…, 1, 1) numbers, in the declared unit.
        until: whether the left side of an until must hold before the witness only
            ("open", as in RTAMT's discrete time) or at the witness, too ("closed", as in Breach).
    """

    grid: Grid
    signals: Mapping[str, FloatArray]
    params: Mapping[str, FloatArray]
    until: Witness = "open"


def robustness(formula: f.Formula, samples: Samples) -> FloatArray:
    """Return (…, n): the robustness of a formula at every sample.

    Positive where the formula holds, negative where it does not, in the unit of
    the formula. Windows are cut at the ends of the trace (see
    :mod:`s2r_spec.robustness.kernels`).

    Raises:
        TraceError: a time bound does not fit the grid, or a predicate has no value (0/0, √−1).
    """
    return _Evaluation(samples).formula(formula)


class _Evaluation:
    """One walk; a node that is used in several places is evaluated once."""

    def __init__(self, samples: Samples) -> None:
        self.samples = samples
        self.done: dict[int, FloatArray] = {}

    def formula(self, node: f.Formula) -> FloatArray:
        if id(node) not in self.done:
            self.done[id(node)] = self._formula(node)
        return self.done[id(node)]

    def value(self, node: f.Value) -> FloatArray:
        if id(node) not in self.done:
            self.done[id(node)] = self._value(node)
        return self.done[id(node)]

    def _formula(self, node: f.Formula) -> FloatArray:
        match node:
            case f.Named():
                return self.formula(node.operand)
            case f.Comparison():
                return self._margin(node)
            case f.Truth():
                return np.full(self.samples.grid.count, np.inf if node.value else -np.inf)
            case f.Not():
                return np.negative(self.formula(node.operand))
            case f.Junction():
                fold = np.minimum if node.operator == "and" else np.maximum
                result = self.formula(node.operands[0])
                for operand in node.operands[1:]:
                    result = fold(result, self.formula(operand))
                return result
            case f.Implication():
                left, right = self.formula(node.left), self.formula(node.right)
                forward = np.maximum(np.negative(left), right)
                return (
                    forward
                    if node.operator == "->"
                    else np.minimum(forward, np.maximum(left, np.negative(right)))
                )
            case f.Rescale():
                return node.factor * self.formula(node.operand)
            case f.Temporal():
                return self._temporal(node)
            case f.Until():
                return self._until(node)
            case f.Step():
                return shift(self.formula(node.operand), 1 if node.operator == "next" else -1, -np.inf)
            case f.Edge():
                now = self.formula(node.operand)
                now = now if node.operator == "rise" else np.negative(now)
                # before the first sample it counts as true already: no edge there
                return np.minimum(now, np.negative(shift(now, -1, np.inf)))
            case _:
                raise AssertionError(node)

    def _temporal(self, node: f.Temporal) -> FloatArray:
        x = self.formula(node.operand)
        low, high = self.samples.grid.window(node.interval)
        match node.operator:
            case "always":
                return window_min(x, low, high)
            case "eventually":
                return window_max(x, low, high)
            case "historically":
                return _backward(window_min(_backward(x), low, high))
            case "once":
                return _backward(window_max(_backward(x), low, high))

    def _until(self, node: f.Until) -> FloatArray:
        left, right = self.formula(node.left), self.formula(node.right)
        low, high = self.samples.grid.window(node.interval)
        match node.operator:
            case "until":
                return self._until_window(left, right, low, high)
            case "since":
                return _backward(self._until_window(_backward(left), _backward(right), low, high))
            case "release":
                return np.negative(self._until_window(np.negative(left), np.negative(right), low, high))
            case "unless":
                return np.maximum(window_min(left, 0, high), self._until_window(left, right, low, high))

    def _until_window(self, left: FloatArray, right: FloatArray, low: int, high: int | None) -> FloatArray:
        if self.samples.until == "closed":
            right = np.minimum(left, right)
        return until(left, right, low, high)

    def _margin(self, node: f.Comparison) -> FloatArray:
        left, right = self.value(node.left)[..., 0, :], self.value(node.right)[..., 0, :]
        with np.errstate(invalid="ignore", over="ignore"):
            match node.operator:
                case "<" | "<=":
                    margin = right - left
                case ">" | ">=":
                    margin = left - right
                case "==":
                    margin = -np.abs(left - right)
                case "!=":
                    margin = np.abs(left - right)
        margin = np.broadcast_to(margin, (*margin.shape[:-1], self.samples.grid.count))
        if np.isnan(margin).any():
            sample = int(np.argwhere(np.isnan(margin))[0][-1])
            raise TraceError(
                f"`{node.span.text}` ({node.span.place}) has no value at sample {sample}, "
                f"{self.samples.grid.seconds(sample):g} s after the first: a division by zero, "
                f"the root of a negative number, or a difference of infinities"
            )
        return margin

    def _value(self, node: f.Value) -> FloatArray:
        match node:
            case f.Number():
                return np.full((1, 1), node.value)
            case f.SignalValue():
                signal = self.samples.signals[node.name]
                return signal if node.index is None else signal[..., node.index : node.index + 1, :]
            case f.ParamValue():
                return self.samples.params[node.name]
            case f.Initial():
                return self.value(node.operand)[..., :1]
            case f.Overshoot():
                return self._overshoot(node)
            case _:
                # a result without a value is reported with its predicate, in _margin
                with np.errstate(all="ignore"):
                    return self._computed(node)

    def _computed(self, node: f.Value) -> FloatArray:
        match node:
            case f.Convert():
                return node.factor * self.value(node.operand) + node.offset
            case f.Arithmetic():
                return _ARITHMETIC[node.operator](self.value(node.left), self.value(node.right))
            case f.Elementary():
                return _ELEMENTARY[node.function](self.value(node.operand))
            case f.Extremum():
                fold = np.minimum if node.function == "min" else np.maximum
                result = self.value(node.operands[0])
                for operand in node.operands[1:]:
                    result = fold(result, self.value(operand))
                return result
            case f.Norm():
                squares = (
                    np.sum(np.square(self.value(part)), axis=-2, keepdims=True) for part in node.operands
                )
                return np.sqrt(sum(squares, start=np.zeros((1, 1))))
            case _:
                raise AssertionError(node)

    def _overshoot(self, node: f.Overshoot) -> FloatArray:
        reference = self.value(node.reference)
        origin = 0.0 if node.origin is None else self.value(node.origin)[..., :1]
        direction = np.where(reference[..., :1] >= origin, 1.0, -1.0)
        with np.errstate(invalid="ignore", over="ignore"):
            return (self.value(node.signal) - reference) * direction


def _backward(x: FloatArray) -> FloatArray:
    return x[..., ::-1]


_ARITHMETIC = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "^": np.power}
_ELEMENTARY = {"minus": np.negative, "abs": np.abs, "sign": np.sign, "sqrt": np.sqrt}
