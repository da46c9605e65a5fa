"""Interval arithmetic over the declared ranges of signals.

A span (low, high) contains every value of a node at later instants. Without information it is (−inf, inf). Undefined
values (0/0) need no span, since the monitor refuses them when they come.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from s2r_spec.lang import formula as f

Span = tuple[float, float]
ANY: Span = (-math.inf, math.inf)


@dataclass(eq=False)
class Spans:
    """Spans of the numbers of a formula.

    Args:
        ranges: signal → its declared range, for those that have one.
        params: parameter → its value.
        settled: returns the constant value of a node from now on (``init`` and the direction of ``overshoot``
            after the first sample), or None.
    """

    ranges: Mapping[str, Span]
    params: Mapping[str, float]
    settled: Callable[[f.Value], Sequence[float] | None]

    def __post_init__(self) -> None:
        self.done: dict[int, tuple[Span, ...]] = {}

    def __call__(self, node: f.Value) -> tuple[Span, ...]:
        """Return the span of each component of a value."""
        if id(node) not in self.done:
            self.done[id(node)] = self._spans(node)
        return self.done[id(node)]

    def margin(self, node: f.Comparison) -> Span:
        """Return the span of a predicate's robustness."""
        (left,), (right,) = self(node.left), self(node.right)
        if node.operator in ("<", "<="):
            return _subtract(right, left)
        if node.operator in (">", ">="):
            return _subtract(left, right)
        size = _absolute(_subtract(left, right))
        return size if node.operator == "!=" else negate(size)

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
                beyond = _subtract(self(node.signal)[0], self(node.reference)[0])
                known = self.settled(node)
                return (
                    _hull(beyond, negate(beyond)) if known is None else _multiply(beyond, (known[0],) * 2),
                )
            case f.Convert():
                return tuple(
                    (node.conversion(low), node.conversion(high)) for low, high in self(node.operand)
                )
            case f.Arithmetic():
                pairs = _spread(self(node.left), self(node.right))
                return tuple(_ARITHMETIC[node.operator](*pair) for pair in pairs)
            case f.Elementary():
                return tuple(_ELEMENTARY[node.function](span) for span in self(node.operand))
            case f.Extremum():
                fold = min if node.function == "min" else max
                lows, highs = zip(*(self(operand)[0] for operand in node.operands), strict=True)
                return ((fold(lows), fold(highs)),)
            case f.Norm():
                sizes = [_absolute(span) for operand in node.operands for span in self(operand)]
                # computed as the value itself, so that rounding keeps the value in its span
                lows, highs = zip(*sizes, strict=True)
                return ((_length(lows), _length(highs)),)
            case f.Choice():
                return tuple(_hull(*pair) for pair in _spread(self(node.left), self(node.right)))
            case f.Delayed():
                return self(node.operand)
            case f.Accumulated():
                spans = self(node.operand)
                return spans if node.function == "mean" else tuple(_area(s, node.seconds) for s in spans)
            case f.Duration() | f.Count():
                return ((0.0, math.inf),)
            case _:  # a derivative: the rate of a signal is unbounded
                return (ANY,) * node.width


def negate(x: Span) -> Span:
    """Return the span of −x."""
    return -x[1], -x[0]


def _spread(left: tuple[Span, ...], right: tuple[Span, ...]) -> list[tuple[Span, Span]]:
    """Pair the components of two values; one of them may be a single number."""
    width = max(len(left), len(right))
    return [(left[k % len(left)], right[k % len(right)]) for k in range(width)]


def _hull(x: Span, y: Span) -> Span:
    return min(x[0], y[0]), max(x[1], y[1])


def _absolute(x: Span) -> Span:
    low, high = abs(x[0]), abs(x[1])
    return (0.0 if x[0] <= 0 <= x[1] else min(low, high)), max(low, high)


def _add(x: Span, y: Span) -> Span:
    return x[0] + y[0], x[1] + y[1]


def _subtract(x: Span, y: Span) -> Span:
    return _add(x, negate(y))


def _multiply(x: Span, y: Span) -> Span:
    return _between([a * b for a in x for b in y])


def _divide(x: Span, y: Span) -> Span:
    return ANY if y[0] <= 0 <= y[1] else _between([a / b for a in x for b in y])


def _between(corners: list[float]) -> Span:
    return ANY if any(map(math.isnan, corners)) else (min(corners), max(corners))


def _raise(x: Span, exponent: Span) -> Span:
    """Return the span of x^e; e is a constant from −9 to 9."""
    e = exponent[0]
    if e == 0:
        return 1.0, 1.0
    if e < 0:
        return _divide((1.0, 1.0), _raise(x, (-e, -e)))
    if not e.is_integer():
        return _power(max(x[0], 0.0), e), _power(max(x[1], 0.0), e)
    if e % 2 == 0:
        x = _absolute(x)
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
    "+": _add, "-": _subtract, "*": _multiply, "/": _divide, "^": _raise,
}  # fmt: skip
_ELEMENTARY: dict[str, Callable[[Span], Span]] = {
    "minus": negate, "abs": _absolute, "sign": _sign, "sqrt": _root,
}  # fmt: skip
