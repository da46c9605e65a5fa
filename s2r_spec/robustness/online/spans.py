"""Interval arithmetic over the declared ranges of signals.

A span (low, high) contains every value of a node at later instants. Without information it is (−inf, inf). Undefined
values (0/0) need no span, since the monitor refuses them when they come.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from s2r_spec.lang import formula as f

Span = tuple[float, float]
ANY: Span = (-math.inf, math.inf)


class Spans:
    """Spans of the numbers of a formula.

    Args:
        ranges: signal → its declared range, for those that have one.
        params: parameter → its value.
        settled: returns the constant value of a node from now on (``init`` and the direction of ``overshoot``
            after the first sample), or None.
    """

    def __init__(
        self,
        ranges: Mapping[str, Span],
        params: Mapping[str, float],
        settled: Callable[[f.Value], Sequence[float] | None],
    ) -> None:
        self.ranges = ranges
        self.params = params
        self.settled = settled
        self.done: dict[int, tuple[Span, ...]] = {}

    def __call__(self, node: f.Value) -> tuple[Span, ...]:
        """Return the span of each component of a value."""
        if id(node) not in self.done:
            self.done[id(node)] = self._spans(node)
        return self.done[id(node)]

    def margin(self, node: f.Comparison) -> Span:
        """Return the span of a predicate's robustness."""
        (left,), (right,) = self(node.left), self(node.right)
        match node.operator:
            case "<" | "<=":
                return subtract(right, left)
            case ">" | ">=":
                return subtract(left, right)
            case "==":
                return negate(absolute(subtract(left, right)))
            case "!=":
                return absolute(subtract(left, right))

    def _spans(self, node: f.Value) -> tuple[Span, ...]:
        match node:
            case f.Number():
                return ((node.value, node.value),)
            case f.ParamValue():
                return ((self.params[node.name],) * 2,)
            case f.SignalValue():
                return (self.ranges.get(node.name, ANY),) * (node.width if node.index is None else 1)
            case f.Initial():
                known = self.settled(node)
                return self(node.operand) if known is None else tuple((value, value) for value in known)
            case f.Overshoot():
                beyond = subtract(self(node.signal)[0], self(node.reference)[0])
                known = self.settled(node)
                return (hull(beyond, negate(beyond)) if known is None else multiply(beyond, (known[0],) * 2),)
            case f.Convert():
                return tuple(
                    (node.conversion(low), node.conversion(high)) for low, high in self(node.operand)
                )
            case f.Arithmetic():
                pairs = spread(self(node.left), self(node.right))
                return tuple(_ARITHMETIC[node.operator](*pair) for pair in pairs)
            case f.Elementary():
                return tuple(_ELEMENTARY[node.function](span) for span in self(node.operand))
            case f.Extremum():
                fold = min if node.function == "min" else max
                parts = [self(operand)[0] for operand in node.operands]
                return ((fold(low for low, _ in parts), fold(high for _, high in parts)),)
            case f.Norm():
                sizes = [absolute(span) for operand in node.operands for span in self(operand)]
                # computed as the value itself, so that rounding keeps the value in its span
                return ((_length(low for low, _ in sizes), _length(high for _, high in sizes)),)
            case f.Choice():
                return tuple(hull(*pair) for pair in spread(self(node.left), self(node.right)))
            case f.Delayed():
                return self(node.operand)
            case f.Accumulated():
                spans = self(node.operand)
                return spans if node.function == "mean" else tuple(_area(s, node.seconds) for s in spans)
            case f.Duration() | f.Count():
                return ((0.0, math.inf),)
            case _:  # a derivative: the rate of a signal is unbounded
                return (ANY,) * node.width


def spread(left: tuple[Span, ...], right: tuple[Span, ...]) -> list[tuple[Span, Span]]:
    """Pair the components of two values; one of them may be a single number."""
    width = max(len(left), len(right))
    return [(left[k % len(left)], right[k % len(right)]) for k in range(width)]


def hull(*spans: Span) -> Span:
    """Return the least span that contains all."""
    return min(low for low, _ in spans), max(high for _, high in spans)


def negate(x: Span) -> Span:
    """Return the span of −x."""
    return -x[1], -x[0]


def absolute(x: Span) -> Span:
    """Return the span of |x|."""
    low, high = abs(x[0]), abs(x[1])
    return (0.0 if x[0] <= 0 <= x[1] else min(low, high)), max(low, high)


def add(x: Span, y: Span) -> Span:
    """Return the span of x + y."""
    return x[0] + y[0], x[1] + y[1]


def subtract(x: Span, y: Span) -> Span:
    """Return the span of x − y."""
    return add(x, negate(y))


def multiply(x: Span, y: Span) -> Span:
    """Return the span of x · y."""
    corners = [a * b for a in x for b in y]
    return ANY if any(map(math.isnan, corners)) else (min(corners), max(corners))


def divide(x: Span, y: Span) -> Span:
    """Return the span of x / y."""
    if y[0] <= 0 <= y[1]:
        return ANY
    corners = [a / b for a in x for b in y]
    return ANY if any(map(math.isnan, corners)) else (min(corners), max(corners))


def power(x: Span, exponent: Span) -> Span:
    """Return the span of x^e; e is a constant from −9 to 9."""
    e = exponent[0]
    if e == 0:
        return 1.0, 1.0
    if e < 0:
        return divide((1.0, 1.0), power(x, (-e, -e)))
    if not e.is_integer():
        return _power(max(x[0], 0.0), e), _power(max(x[1], 0.0), e)
    if e % 2 == 0:
        x = absolute(x)
    return _power(x[0], e), _power(x[1], e)


def _power(x: float, e: float) -> float:
    try:
        return math.pow(x, e)
    except OverflowError:
        return math.copysign(math.inf, x) if e % 2 == 1 else math.inf


def _length(parts: Iterable[float]) -> float:
    total = 0.0
    for part in parts:
        total += part * part
    return math.sqrt(total)


def _root(x: Span) -> Span:
    return math.sqrt(max(x[0], 0.0)), math.sqrt(max(x[1], 0.0))


def _sign(x: Span) -> Span:
    low, high = ((end > 0) - (end < 0) for end in x)
    return float(low), float(high)


def _area(x: Span, seconds: float) -> Span:
    if seconds == 0:
        return 0.0, 0.0
    return min(0.0, x[0] * seconds if x[0] else 0.0), max(0.0, x[1] * seconds if x[1] else 0.0)


_ARITHMETIC: dict[str, Callable[[Span, Span], Span]] = {
    "+": add, "-": subtract, "*": multiply, "/": divide, "^": power,
}  # fmt: skip
_ELEMENTARY: dict[str, Callable[[Span], Span]] = {
    "minus": negate, "abs": absolute, "sign": _sign, "sqrt": _root,
}  # fmt: skip
