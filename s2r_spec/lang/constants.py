"""Evaluation of constant expressions: time bounds, ranges, constants, settings."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable

from s2r_spec.lang import formula as f


def constant(value: f.Value) -> float | None:
    """Return the number of a constant value; None if it depends on a trace or a parameter.

    An undefined number (1/0, the root of −1) is NaN.
    """
    try:
        return _constant(value)
    except (ArithmeticError, ValueError):
        return math.nan


def _constant(value: f.Value) -> float | None:
    match value:
        case f.Number():
            return value.value
        case f.Convert():
            operand = _constant(value.operand)
            return None if operand is None else value.conversion(operand)
        case f.Elementary():
            operand = _constant(value.operand)
            return None if operand is None else _FUNCTIONS[value.function](operand)
        case f.Arithmetic():
            # the right operand is visited only if the left one is constant, to save time on shared parts
            left = _constant(value.left)
            right = None if left is None else _constant(value.right)
            return None if left is None or right is None else _OPERATORS[value.operator](left, right)
        case f.Extremum() | f.Norm():
            operands: list[float] = []
            for part in value.operands:
                number = _constant(part)
                if number is None:
                    return None
                operands.append(number)
            if isinstance(value, f.Norm):
                return math.hypot(*operands)
            return min(operands) if value.function == "min" else max(operands)
        case _:
            return None


_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "minus": operator.neg,
    "abs": abs,
    "sqrt": math.sqrt,
    "sign": lambda operand: math.copysign(1.0, operand) if operand else 0.0,
}
_OPERATORS: dict[f.ArithmeticOp, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "^": math.pow,
}
