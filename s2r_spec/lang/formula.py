"""The checked form of a specification: names resolved, units settled, times in seconds.

A :class:`Value` is a number at each instant, a :class:`Formula` a condition,
whose robustness is a number at each instant. Every number is in the unit of
its node; where two units of one dimension meet, a :class:`Convert` or a
:class:`Rescale` stands between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Literal

from s2r_spec.lang.source import Span
from s2r_spec.lang.syntax import StepOp, TemporalOp, UntilOp
from s2r_spec.lang.units import Unit

CompareOp = Literal["<", "<=", ">", ">=", "==", "!="]
ArithmeticOp = Literal["+", "-", "*", "/", "^"]

MIXED = Unit("mixed", (("mixed", 1.0),))
"""Unit of a robustness that is the least of margins in units that do not go together."""


@dataclass(frozen=True)
class ParamTime:
    """A time that a parameter gives: factor · value [s]."""

    name: str
    factor: float


@dataclass(frozen=True)
class Interval:
    """A time interval relative to an instant, in seconds; ``high`` may be inf.

    Args:
        low: 0 ≤ low ≤ high; the least of a parameter's range.
        high: at least ``low``; the greatest of a parameter's range.
        low_closed: whether ``low`` itself belongs to it.
        high_closed: whether ``high`` itself belongs to it.
        span: where it is written, or where the operator is if it has none.
        low_param: the parameter that ``low`` is, until a trace is evaluated with its value.
        high_param: the parameter that ``high`` is.
    """

    low: float
    high: float
    low_closed: bool
    high_closed: bool
    span: Span
    low_param: ParamTime | None = None
    high_param: ParamTime | None = None

    @property
    def param_times(self) -> tuple[ParamTime, ...]:
        """The ends that are parameters."""
        return tuple(end for end in (self.low_param, self.high_param) if end is not None)


@dataclass(frozen=True, kw_only=True)
class Node:
    """Anything with a place in the text."""

    span: Span


@dataclass(frozen=True, kw_only=True)
class Value(Node):
    """A number at each instant, or ``width`` of them; without a unit it takes that of its neighbour."""

    unit: Unit | None
    width: int = 1


@dataclass(frozen=True, kw_only=True)
class Number(Value):
    """A constant."""

    value: float


@dataclass(frozen=True, kw_only=True)
class SignalValue(Value):
    """A signal, or one component of it."""

    name: str
    index: int | None = None


@dataclass(frozen=True, kw_only=True)
class ParamValue(Value):
    """A test parameter."""

    name: str


@dataclass(frozen=True, kw_only=True)
class Convert(Value):
    """factor · operand + offset: the same quantity in another unit."""

    operand: Value
    factor: float
    offset: float


@dataclass(frozen=True, kw_only=True)
class Arithmetic(Value):
    """left ∘ right."""

    operator: ArithmeticOp
    left: Value
    right: Value


@dataclass(frozen=True, kw_only=True)
class Elementary(Value):
    """A function of one number."""

    function: Literal["minus", "abs", "sign", "sqrt"]
    operand: Value


@dataclass(frozen=True, kw_only=True)
class Extremum(Value):
    """The least or the greatest of several numbers."""

    function: Literal["min", "max"]
    operands: tuple[Value, ...]


@dataclass(frozen=True, kw_only=True)
class Norm(Value):
    """Euclidean length of all components of the operands together."""

    operands: tuple[Value, ...]


@dataclass(frozen=True, kw_only=True)
class Initial(Value):
    """The operand at the trace's first sample, at every instant."""

    operand: Value


@dataclass(frozen=True, kw_only=True)
class Overshoot(Value):
    """(signal − reference) · dir, by how much the signal is beyond its reference.

    dir is +1 if reference ≥ origin at the trace's first sample, else −1; it is
    never 0. Without an origin the motion starts from 0: dir is then the sign of
    the command, which is the paper's "in the event the desired velocity is
    negative, overshoot is calculated in the opposite direction".
    """

    signal: Value
    reference: Value
    origin: Value | None


@dataclass(frozen=True, kw_only=True)
class Delayed(Value):
    """The operand ``seconds`` ago: its last sample at or before then, its first one before the trace."""

    operand: Value
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Derivative(Value):
    """Difference to the sample before, over the time between them; at the first sample as at the second."""

    operand: Value


@dataclass(frozen=True, kw_only=True)
class Accumulated(Value):
    """Integral over the last ``seconds``, or mean over them, of straight lines between samples.

    Without ``seconds`` (inf) from the first sample on; never from before it.
    """

    function: Literal["integral", "mean"]
    operand: Value
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Duration(Value):
    """For how long the operand has held at every sample, up to now [s]; 0 where it does not hold."""

    operand: Formula


@dataclass(frozen=True, kw_only=True)
class Count(Value):
    """At how many samples of the last ``seconds`` (inf: of all so far) the operand held."""

    operand: Formula
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Choice(Value):
    """``left`` where the condition holds, else ``right``."""

    condition: Formula
    left: Value
    right: Value


@dataclass(frozen=True, kw_only=True)
class Formula(Node):
    """A condition; ``unit`` is that of its robustness, None if nothing in it has a unit."""

    unit: Unit | None


@dataclass(frozen=True, kw_only=True)
class Truth(Formula):
    """true (+inf) or false (−inf)."""

    value: bool


@dataclass(frozen=True, kw_only=True)
class Flag(Formula):
    """A boolean signal: +inf where it is true, −inf where it is not."""

    name: str


@dataclass(frozen=True, kw_only=True)
class Comparison(Formula):
    """A predicate. Its robustness is right − left for ``<`` and ``<=``, −abs(left − right) for ``==``."""

    operator: CompareOp
    left: Value
    right: Value


@dataclass(frozen=True, kw_only=True)
class Not(Formula):
    """Negation."""

    operand: Formula


@dataclass(frozen=True, kw_only=True)
class Junction(Formula):
    """Conjunction (the least) or disjunction (the greatest)."""

    operator: Literal["and", "or"]
    operands: tuple[Formula, ...]


@dataclass(frozen=True, kw_only=True)
class Implication(Formula):
    """``->`` or ``<->``."""

    operator: Literal["->", "<->"]
    left: Formula
    right: Formula


@dataclass(frozen=True, kw_only=True)
class Rescale(Formula):
    """factor · robustness: the same margin in another unit; factor > 0."""

    operand: Formula
    factor: float


@dataclass(frozen=True, kw_only=True)
class Temporal(Formula):
    """always, eventually and their mirror images in the past."""

    operator: TemporalOp
    interval: Interval
    operand: Formula


@dataclass(frozen=True, kw_only=True)
class Until(Formula):
    """until, release, unless, and since (until in the past)."""

    operator: UntilOp
    interval: Interval
    left: Formula
    right: Formula


@dataclass(frozen=True, kw_only=True)
class Step(Formula):
    """The operand one sample later or earlier; −inf where there is none."""

    operator: StepOp
    operand: Formula


@dataclass(frozen=True, kw_only=True)
class Edge(Formula):
    """The operand becomes true (rise) or false (fall) at this sample; never at the first one."""

    operator: Literal["rise", "fall"]
    operand: Formula


@dataclass(frozen=True, kw_only=True)
class Named(Formula):
    """A use of a named sub-formula; all uses share one operand."""

    name: str
    operand: Formula


@cache
def _names(kind: Any) -> tuple[str, ...]:
    return tuple(item.name for item in fields(kind) if item.name not in ("span", "unit", "width"))


def children(node: Node) -> Iterator[Node]:
    """Yield the nodes directly below, left to right."""
    kind: Any = type(node)  # mypy takes the class of a dataclass for unhashable
    for name in _names(kind):
        held = getattr(node, name)
        if isinstance(held, Node):
            yield held
        elif isinstance(held, tuple):
            yield from held


def walk(node: Node) -> Iterator[Node]:
    """Yield the node and all below it, each shared one once."""
    seen: set[int] = set()
    stack = [node]
    while stack:
        current = stack.pop()
        if id(current) not in seen:
            seen.add(id(current))
            yield current
            stack.extend(reversed(list(children(current))))
