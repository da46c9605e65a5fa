"""The gradient of a predicate's margin in the samples of its signals, by one backward pass.

:func:`s2r_spec.robustness.deciding.descend` finds the predicate and the sample that decide ρ.
:meth:`s2r_spec.spec.Spec.robustness_tensor` has gradients from torch, but of fewer functions and for a whole formula.
Tests compare the two.
"""

from __future__ import annotations

import numpy as np

from s2r_spec.base.arrays import FloatArray, IntArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.numbers import Numbers


def margin_gradient(node: f.Comparison, numbers: Numbers, sample: int) -> dict[str, FloatArray]:
    """Return signal → (width, n): ∂ margin(sample) / ∂ signal, a sub-gradient at kinks.

    Functions that only jump (``sign``, ``duration``, ``count``, the condition of a choice) add nothing.
    """
    seed = np.zeros((1, numbers.clock.count))
    seed[0, sample] = 1.0
    back = _Backwards(numbers)
    left, right = numbers(node.left)[..., 0, :], numbers(node.right)[..., 0, :]
    sign = -1.0 if node.operator in ("<", "<=") else 1.0
    if node.operator in ("==", "!="):
        ahead = np.broadcast_to(left >= right, (numbers.clock.count,))[sample]
        sign = 1.0 if ahead == (node.operator == "!=") else -1.0
    with np.errstate(all="ignore"):
        back.add(node.left, sign * seed)
        back.add(node.right, -sign * seed)
    return back.found


class _Backwards:
    def __init__(self, numbers: Numbers) -> None:
        self.numbers = numbers
        self.n = numbers.clock.count
        self.found: dict[str, FloatArray] = {}

    def add(self, node: f.Value, seed: FloatArray) -> None:
        """Add the gradient of ``seed`` · node, (width, n) each, in the signals."""
        match node:
            case f.SignalValue():
                held = self.found.setdefault(node.name, np.zeros_like(self.numbers.signals[node.name]))
                held[slice(None) if node.index is None else [node.index]] += seed
            case f.Initial():
                first = np.zeros_like(seed)
                first[:, 0] = seed.sum(axis=1)
                self.add(node.operand, first)
            case f.Overshoot():
                toward = self.numbers.direction(node) * seed
                self.add(node.signal, toward)
                self.add(node.reference, -toward)
            case f.Convert():
                self.add(node.operand, node.conversion.factor * seed)
            case f.Arithmetic():
                self._arithmetic(node, seed)
            case f.Elementary():
                self.add(node.operand, seed * self._slope(node))
            case f.Extremum():
                values = [np.broadcast_to(self.numbers(part), seed.shape) for part in node.operands]
                chosen = (np.argmin if node.function == "min" else np.argmax)(values, axis=0)
                for place, part in enumerate(node.operands):
                    self.add(part, np.where(chosen == place, seed, 0.0))
            case f.Choice():
                holds = self.numbers.holds(node.condition)
                self.add(node.left, np.where(holds, seed, 0.0))
                self.add(node.right, np.where(holds, 0.0, seed))
            case f.Norm():
                length = self.numbers(node)
                for part in node.operands:
                    direction = self.numbers(part) / np.where(length > 0, length, np.inf)
                    self.add(part, seed * direction)
            case f.Delayed() | f.Derivative() | f.Accumulated():
                self.add(node.operand, self._history(node, seed))
            case _:
                pass  # constants, parameters, and functions that only jump

    def _arithmetic(self, node: f.Arithmetic, seed: FloatArray) -> None:
        left, right = self.numbers(node.left), self.numbers(node.right)
        one = np.ones((1, 1))
        slopes: tuple[FloatArray, FloatArray]
        match node.operator:
            case "+":
                slopes = one, one
            case "-":
                slopes = one, -one
            case "*":
                slopes = right, left
            case "/":
                slopes = 1.0 / right, -left / np.square(right)
            case "^":
                slopes = right * left ** (right - 1.0), 0.0 * one  # an exponent is a constant
        for part, slope in zip((node.left, node.right), slopes, strict=True):
            self.add(part, np.where(seed != 0, seed * slope, 0.0))

    def _slope(self, node: f.Elementary) -> FloatArray:
        match node.function:
            case "minus":
                return -np.ones((1, 1))
            case "abs":
                side: FloatArray = np.sign(self.numbers(node.operand))
                return side
            case "sqrt":
                root = self.numbers(node)
                return np.where(root > 0, 0.5 / root, 0.0)
            case _:
                return np.zeros((1, 1))

    def _history(self, node: f.Delayed | f.Derivative | f.Accumulated, seed: FloatArray) -> FloatArray:
        """Return the seed of the operand: the transpose of :mod:`s2r_spec.robustness.history`."""
        times, snap = self.numbers.clock.times, self.numbers.clock.snap
        match node:
            case f.Delayed():
                index = np.searchsorted(times, times - node.seconds + snap, "right") - 1
                return _scatter(seed, np.maximum(index, 0))
            case f.Derivative():
                if self.n == 1:
                    return np.zeros_like(seed)
                steps = seed[:, 1:].copy()
                steps[:, 0] += seed[:, 0]
                return _differences(steps / np.diff(times))
            case f.Accumulated(function="mean"):
                elapsed = np.minimum(times - times[0], node.seconds)
                moved = np.where(elapsed > 0, seed / np.where(elapsed > 0, elapsed, 1.0), 0.0)
                return _integral(moved, times, node.seconds) + np.where(elapsed > 0, 0.0, seed)
            case _:
                return _integral(seed, times, node.seconds)


def _scatter(seed: FloatArray, index: IntArray) -> FloatArray:
    """Return the transpose of ``x[:, index]``."""
    result = np.zeros_like(seed)
    for row, held in zip(seed, result, strict=True):
        np.add.at(held, index, row)
    return result


def _differences(steps: FloatArray) -> FloatArray:
    """Return the transpose of ``np.diff``."""
    none = np.zeros_like(steps[:, :1])
    result: FloatArray = np.hstack((none, steps)) - np.hstack((steps, none))
    return result


def _integral(seed: FloatArray, times: FloatArray, seconds: float) -> FloatArray:
    if times.size == 1:
        return np.zeros_like(seed)
    gaps, total, result = np.diff(times), seed, np.zeros_like(seed)
    if np.isfinite(seconds):
        start = np.maximum(times - seconds, times[0])
        before = np.minimum(np.searchsorted(times, start, "right") - 1, times.size - 2)
        part = start - times[before]
        total = seed - _scatter(seed, before)
        result -= _scatter(seed * part, before)
        result -= _differences(_scatter(seed * np.square(part) / 2, before)[:, :-1] / gaps)
    # every later total contains a step
    later = np.cumsum(total[:, :0:-1], axis=1)[:, ::-1] * gaps / 2
    result[:, 1:] += later
    result[:, :-1] += later
    return result
