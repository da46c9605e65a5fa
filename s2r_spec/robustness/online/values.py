"""The numbers that a predicate compares, one instant at a time.

The same semantics as :mod:`s2r_spec.robustness.numbers`, with plain floats: for a single number they are ten times
as fast as arrays.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from s2r_spec.lang import formula as f
from s2r_spec.robustness.online import history
from s2r_spec.robustness.online.clock import Component, InstantNumber, OnlineClock
from s2r_spec.robustness.online.tape import InstantSource, Tape, greater, lesser


@dataclass(eq=False)
class NumberBuilder:
    """Makes the numbers of formulas.

    Args:
        clock: the clock of the trace.
        signals: name → a tape for each component.
        params: name → value.
        roots: all formulas that will be evaluated.
        condition: a function that makes the evaluator of the conditions in ``if``, ``duration`` and ``count``.
    """

    clock: OnlineClock
    signals: Mapping[str, Sequence[Tape]]
    params: Mapping[str, float]
    roots: Iterable[f.Formula]
    condition: Callable[[f.Formula], InstantSource]

    def __post_init__(self) -> None:
        self.done: dict[int, InstantNumber] = {}
        self.firsts: dict[int, tuple[_First, ...]] = {}
        nodes = {id(node): node for root in self.roots for node in f.walk(root)}
        self.uses = Counter(id(child) for node in nodes.values() for child in f.children(node))

    def __call__(self, node: f.Value) -> InstantNumber:
        """Return the number of a node."""
        if id(node) not in self.done:
            number = self._number(node)
            if self.uses[id(node)] > 1:  # otherwise shared parts would be computed repeatedly
                number = InstantNumber(tuple(map(_Remembered, number.parts)), number.sources)
            self.done[id(node)] = number
        return self.done[id(node)]

    def settled(self, node: f.Value) -> Sequence[float] | None:
        """Return the value of ``init``, or the direction of ``overshoot``; None before the first sample."""
        firsts = self.firsts.get(id(node), ())
        values = [first.value for first in firsts if first.value is not None]
        return values if values and len(values) == len(firsts) else None

    def _number(self, node: f.Value) -> InstantNumber:
        match node:
            case f.Number():
                return InstantNumber((_constant(node.value),))
            case f.ParamValue():
                return InstantNumber((_constant(self.params[node.name]),))
            case f.SignalValue():
                tapes = self.signals[node.name]
                tapes = tapes if node.index is None else tapes[node.index : node.index + 1]
                return InstantNumber(tuple(tape.value for tape in tapes), tuple(tapes))
            case f.Initial():
                operand = self(node.operand)
                firsts = self.firsts[id(node)] = tuple(map(_First, operand.parts))
                return InstantNumber(firsts, operand.sources)
            case f.Overshoot():
                return self._overshoot(node)
            case f.Convert():
                return self._each(node.conversion, node.operand)
            case f.Arithmetic():
                return self._each(_ARITHMETIC[node.operator], node.left, node.right)
            case f.Elementary():
                return self._each(_ELEMENTARY[node.function], node.operand)
            case f.Extremum():
                return self._fold(lesser if node.function == "min" else greater, node.operands)
            case f.Norm():
                parts = tuple(part for operand in node.operands for part in self(operand).parts)
                return InstantNumber(
                    (lambda k: math.sqrt(_squares(parts, k)),), self._sources(*node.operands)
                )
            case f.Choice():
                return self._choice(node)
            case _:
                return self._history(node)

    def _sources(self, *nodes: f.Value) -> tuple[InstantSource, ...]:
        return tuple({id(s): s for node in nodes for s in self(node).sources}.values())

    def _each(self, function: Callable[..., float], *nodes: f.Value) -> InstantNumber:
        """Apply a function of one or two numbers to each component."""
        operands = [self(node).parts for node in nodes]
        width = max(map(len, operands))
        parts = [_apply(function, [parts[i % len(parts)] for parts in operands]) for i in range(width)]
        return InstantNumber(tuple(parts), self._sources(*nodes))

    def _fold(self, function: Callable[[float, float], float], nodes: Sequence[f.Value]) -> InstantNumber:
        first, *rest = (self(node).parts[0] for node in nodes)

        def value(k: int) -> float:
            result = first(k)
            for part in rest:
                result = function(result, part(k))
            return result

        return InstantNumber((value,), self._sources(*nodes))

    def _overshoot(self, node: f.Overshoot) -> InstantNumber:
        signal, reference = self(node.signal).parts[0], self(node.reference).parts[0]
        origin = _constant(0.0) if node.origin is None else self(node.origin).parts[0]
        direction = _First(lambda k: 1.0 if reference(k) >= origin(k) else -1.0)
        self.firsts[id(node)] = (direction,)
        read = (node.signal, node.reference, *(() if node.origin is None else (node.origin,)))
        return InstantNumber((lambda k: (signal(k) - reference(k)) * direction(k),), self._sources(*read))

    def _choice(self, node: f.Choice) -> InstantNumber:
        condition = self.condition(node.condition)
        left, right = self(node.left).parts, self(node.right).parts

        def chosen(yes: Component, no: Component) -> Component:
            def value(k: int) -> float:
                values = yes(k), no(k)  # both are evaluated, since their parts may store their first sample
                return values[0] if condition.value(k) > 0 else values[1]

            return value

        width = max(len(left), len(right))
        parts = tuple(chosen(left[i % len(left)], right[i % len(right)]) for i in range(width))
        return InstantNumber(parts, (*self._sources(node.left, node.right), condition))

    def _history(self, node: f.Value) -> InstantNumber:
        make: Callable[[OnlineClock, InstantNumber, Component], history.TapedNumber]
        match node:
            case f.Duration():
                make = history.Duration
            case f.Count():
                make = partial(history.Count, seconds=node.seconds)
            case f.Delayed():
                make = partial(history.Delayed, seconds=node.seconds)
            case f.Derivative():
                make = history.Derivative
            case f.Accumulated():
                make = partial(history.Accumulated, seconds=node.seconds, mean=node.function == "mean")
            case _:
                raise AssertionError(node)
        if isinstance(node, f.Duration | f.Count):
            condition = self.condition(node.operand)
            operand = InstantNumber((condition.value,), (condition,))
        else:
            operand = self(node.operand)
        made = [make(self.clock, operand, part) for part in operand.parts]
        self.clock.streams.extend(made)
        return InstantNumber(tuple(one.tape.value for one in made), tuple(one.tape for one in made))


class _First:
    """The value of a number at the first instant, for every instant. It is evaluated at the first one first."""

    def __init__(self, part: Component) -> None:
        self.part = part
        self.value: float | None = None

    def __call__(self, k: int) -> float:
        if self.value is None:
            self.value = self.part(0)
        return self.value


class _Remembered:
    """A number that is computed once for each instant."""

    def __init__(self, part: Component) -> None:
        self.part = part
        self.instant = -1
        self.value = math.nan

    def __call__(self, k: int) -> float:
        if k != self.instant:
            self.instant, self.value = k, self.part(k)
        return self.value


def _constant(value: float) -> Component:
    return lambda k: value


def _apply(function: Callable[..., float], parts: Sequence[Component]) -> Component:
    if len(parts) == 1:
        (part,) = parts
        return lambda k: function(part(k))
    left, right = parts
    return lambda k: function(left(k), right(k))


def _squares(parts: Sequence[Component], k: int) -> float:
    total = 0.0
    for part in parts:
        x = part(k)
        total += x * x
    return total


def _quotient(x: float, y: float) -> float:
    try:
        return x / y
    except ZeroDivisionError:
        return math.nan if x == 0 or x != x else math.copysign(math.inf, x) * math.copysign(1.0, y)


def _power(x: float, y: float) -> float:
    try:
        return math.pow(x, y)
    except (OverflowError, ValueError):
        with np.errstate(all="ignore"):
            return float(np.power(x, y))


def _sign(x: float) -> float:
    return x if x != x else float((x > 0) - (x < 0))


def _root(x: float) -> float:
    return math.sqrt(x) if x >= 0 else math.nan


_ARITHMETIC: dict[str, Callable[[float, float], float]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": _quotient, "^": _power,
}  # fmt: skip
_ELEMENTARY: dict[str, Callable[[float], float]] = {
    "minus": operator.neg, "abs": abs, "sign": _sign, "sqrt": _root,
}  # fmt: skip
