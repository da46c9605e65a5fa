"""The checked form of a specification: names are resolved, units are known, times are in seconds.

A :class:`Value` is a number at each instant. A :class:`Formula` is a condition; its robustness is a number at
each instant. Every number is in the unit of its node. Between two nodes with different units of one dimension
there is a :class:`Convert` or a :class:`Rescale`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, Field, FrozenInstanceError, dataclass, fields
from functools import cache
from typing import Any, ClassVar, Literal, dataclass_transform

from s2r_spec.lang.conversion import Conversion
from s2r_spec.lang.source import Span
from s2r_spec.lang.units import Unit

CompareOp = Literal["<", "<=", ">", ">=", "==", "!="]
ArithmeticOp = Literal["+", "-", "*", "/", "^"]
TemporalOp = Literal["always", "eventually", "historically", "once"]
UntilOp = Literal["until", "since", "release", "unless"]
StepOp = Literal["next", "prev"]

MIXED = Unit("mixed", (("mixed", 1.0),))
"""Unit of a robustness that combines margins of different dimensions."""


@dataclass(frozen=True)
class ParamTime:
    """A time bound that is a parameter: factor · value [s]."""

    name: str
    factor: float


@dataclass(frozen=True)
class Interval:
    """A time interval relative to an instant, in seconds; ``high`` may be inf.

    Args:
        low: 0 ≤ low ≤ high [s]; for a parameter, the least value of its range.
        high: [s], at least ``low``; for a parameter, the greatest value of its range.
        low_closed: whether ``low`` itself belongs to it.
        high_closed: whether ``high`` itself belongs to it.
        span: the place of the formula in the text, or of its operator if the formula is not written.
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


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Record:
    """A base whose subclasses are frozen dataclasses with keywords alone, without a decorator on each.

    It has their methods once. Else Python would write six methods for each of sixty classes at every start.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __init_subclass__(cls) -> None:
        dataclass(init=False, repr=False, eq=False, kw_only=True)(cls)

    def __init__(self, **values: Any) -> None:
        own = self.__dict__
        for name, one in self.__dataclass_fields__.items():
            own[name] = values.pop(name, one.default)
            if own[name] is MISSING:
                raise TypeError(f"{type(self).__name__} lacks {name}")
        if values:
            raise TypeError(f"{type(self).__name__} has no {', '.join(values)}")

    def __setattr__(self, name: str, value: object) -> None:
        raise FrozenInstanceError(f"cannot assign to field {name!r}")

    def __delattr__(self, name: str) -> None:
        raise FrozenInstanceError(f"cannot delete field {name!r}")

    def __eq__(self, other: object) -> bool:
        return self.__dict__ == other.__dict__ if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(tuple(self.__dict__.values()))

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self.__dict__.items())
        return f"{type(self).__name__}({values})"


class Node(Record):
    """A node of a tree, before or after the check, with its place in the text."""

    span: Span


class Value(Node):
    """A vector of ``width`` numbers at each instant; with unit None it takes the unit of its neighbour."""

    unit: Unit | None
    width: int = 1


class Number(Value):
    """A constant."""

    value: float


class SignalValue(Value):
    """A signal, or one component of it."""

    name: str
    index: int | None = None


class ParamValue(Value):
    """A test parameter."""

    name: str


class Convert(Value):
    """The same quantity in another unit."""

    operand: Value
    conversion: Conversion


class Arithmetic(Value):
    """left ∘ right."""

    operator: ArithmeticOp
    left: Value
    right: Value


class Elementary(Value):
    """A function of one number."""

    function: Literal["minus", "abs", "sign", "sqrt"]
    operand: Value


class Extremum(Value):
    """The least or the greatest of several numbers."""

    function: Literal["min", "max"]
    operands: tuple[Value, ...]


class Norm(Value):
    """Euclidean length of all components of the operands together."""

    operands: tuple[Value, ...]


class Initial(Value):
    """The operand at the trace's first sample, at every instant."""

    operand: Value


class Overshoot(Value):
    """(signal − reference) · dir: the distance of the signal beyond its reference.

    dir is +1 if reference ≥ origin at the trace's first sample, else −1; it is never 0. Without an origin the
    motion starts from 0, and dir is the sign of the command. The paper says: "in the event the desired velocity
    is negative, overshoot is calculated in the opposite direction".
    """

    signal: Value
    reference: Value
    origin: Value | None


class Delayed(Value):
    """The operand ``seconds`` ago: its last sample at or before that time, or else its first sample."""

    operand: Value
    seconds: float


class Derivative(Value):
    """Backward difference quotient; the first sample has the value of the second."""

    operand: Value


class Accumulated(Value):
    """Integral or mean over the last ``seconds``, with straight lines between samples.

    It begins at the first sample at the earliest; ``seconds`` = inf means from the first sample on.
    """

    function: Literal["integral", "mean"]
    operand: Value
    seconds: float


class Duration(Value):
    """Time for which the operand has held without a break, up to now [s]; 0 where it does not hold."""

    operand: Formula


class Count(Value):
    """Number of samples in the last ``seconds`` at which the operand held; inf means all samples so far."""

    operand: Formula
    seconds: float


class Choice(Value):
    """``left`` where the condition holds, else ``right``."""

    condition: Formula
    left: Value
    right: Value


class Formula(Node):
    """A condition; ``unit`` is the unit of its robustness, None if nothing in it has a unit."""

    unit: Unit | None


class Truth(Formula):
    """true (+inf) or false (−inf)."""

    value: bool


class Flag(Formula):
    """A boolean signal: +inf where it is true, −inf where it is not."""

    name: str


class Comparison(Formula):
    """A predicate. Its robustness is right − left for ``<`` and ``<=``, −abs(left − right) for ``==``."""

    operator: CompareOp
    left: Value
    right: Value


class Not(Formula):
    """Negation."""

    operand: Formula


class Junction(Formula):
    """Conjunction (the least) or disjunction (the greatest)."""

    operator: Literal["and", "or"]
    operands: tuple[Formula, ...]


class Implication(Formula):
    """``->`` or ``<->``."""

    operator: Literal["->", "<->"]
    left: Formula
    right: Formula


class Rescale(Formula):
    """factor · robustness: the same margin in another unit; factor > 0."""

    operand: Formula
    factor: float


class Temporal(Formula):
    """always, eventually, and their counterparts in the past, historically and once."""

    operator: TemporalOp
    interval: Interval
    operand: Formula


class Until(Formula):
    """until, release, unless, and since (until in the past)."""

    operator: UntilOp
    interval: Interval
    left: Formula
    right: Formula


class AdjacentSample(Formula):
    """The operand one sample later or earlier; −inf where there is none."""

    operator: StepOp
    operand: Formula


class Edge(Formula):
    """The operand becomes true (rise) or false (fall) at this sample; never at the first one."""

    operator: Literal["rise", "fall"]
    operand: Formula


class Named(Formula):
    """A use of a named sub-formula; all uses share the same operand."""

    name: str
    operand: Formula


@cache
def _names(kind: Any) -> tuple[str, ...]:
    return tuple(item.name for item in fields(kind) if item.name not in ("span", "width"))


def children(node: Node) -> Iterator[Node]:
    """Yield the nodes directly below, left to right; every tuple in a node holds nodes."""
    kind: Any = type(node)  # mypy believes that the class of a dataclass is unhashable
    for name in _names(kind):
        part = getattr(node, name)
        if isinstance(part, Node):
            yield part
        elif isinstance(part, tuple):
            yield from part


def walk(*nodes: Node) -> Iterator[Node]:
    """Yield the nodes and all nodes below them, in the order of the text; a shared node is yielded once."""
    seen: set[int] = set()
    stack = list(reversed(nodes))
    while stack:
        current = stack.pop()
        if id(current) not in seen:
            seen.add(id(current))
            yield current
            stack.extend(reversed(list(children(current))))
