"""The syntax tree of a specification, before any check."""

from __future__ import annotations

from typing import Literal

from s2r_spec.lang.formula import Node, StepOp, TemporalOp, UntilOp


class Word(Node):
    """A name, a keyword or an operator, as written."""

    text: str


class Number(Node):
    """``0.05 {m/s}``."""

    value: float
    unit: Word | None


class Name(Node):
    """A use of a declared name."""

    name: str


class Index(Node):
    """``u[0]``, counted from 0."""

    name: Word
    index: Number


class Call(Node):
    """``abs(x)``."""

    function: Word
    arguments: tuple[Expression, ...]


class Truth(Node):
    """``true`` or ``false``."""

    value: bool


class Minus(Node):
    """``-x``."""

    operand: Expression


class Arithmetic(Node):
    """``left + right`` with + - * / ^."""

    operator: Word
    left: Expression
    right: Expression


class Comparison(Node):
    """``0 <= x <= 2``: one operator fewer than operands."""

    operators: tuple[Word, ...]
    operands: tuple[Expression, ...]


class Negation(Node):
    """``not φ``."""

    operand: Expression


class Junction(Node):
    """``φ and ψ and …`` or ``φ or ψ or …``."""

    operator: Literal["and", "or"]
    operands: tuple[Expression, ...]


class Implication(Node):
    """``φ -> ψ`` or ``φ <-> ψ``."""

    operator: Literal["->", "<->"]
    left: Expression
    right: Expression


class Bound(Node):
    """One end of an interval; without an expression it is ``inf``."""

    value: Expression | None
    unit: Word | None


class Interval(Node):
    """``[a, b]``, ``(a, b]``, ``[a, b)`` or ``(a, b)``."""

    low: Bound
    high: Bound
    low_closed: bool
    high_closed: bool


class Temporal(Node):
    """``always[a, b] φ``."""

    operator: TemporalOp
    interval: Interval | None
    operand: Expression


class UntilLink(Node):
    """The part ``until[a, b] ψ`` of an until."""

    operator: UntilOp
    word: Word
    interval: Interval | None
    operand: Expression


class Until(Node):
    """``φ until[a, b] ψ``; more than one link is a mistake, which a rule reports."""

    left: Expression
    links: tuple[UntilLink, ...]


class AdjacentSample(Node):
    """``next φ``."""

    operator: StepOp
    operand: Expression


Expression = (
    Number | Name | Index | Call | Truth | Minus | Arithmetic | Comparison
    | Negation | Junction | Implication | Temporal | Until | AdjacentSample
)  # fmt: skip


class Range(Node):
    """``in [low, high]``."""

    low: Expression
    high: Expression


class Signal(Node):
    """``signal u[3] {V} in [-24, 24]``, or ``signal contact bool``."""

    name: Word
    dim: Number | None
    boolean: bool
    unit: Word | None
    range: Range | None


class Param(Node):
    """``param vd {m/s} = 0.1 in [-0.2, 0.3]``."""

    name: Word
    unit: Word | None
    default: Expression | None
    range: Range | None


class Const(Node):
    """``const tol {m/s} = 0.05``."""

    name: Word
    unit: Word | None
    value: Expression


class Let(Node):
    """``let settled := φ``; φ may be a number, too."""

    name: Word
    body: Expression


class Require(Node):
    """``require walking: φ``."""

    name: Word
    body: Expression


class Setting(Node):
    """``delta = 1e-6``."""

    key: Word
    value: Expression


class Certify(Node):
    """``certify walking: delta = 1e-6, …``; without a name it is for every requirement."""

    name: Word | None
    settings: tuple[Setting, ...]


class Import(Node):
    """``import "robot.stl"``."""

    path: Word


class Broken(Node):
    """A statement that did not parse: only its keyword and name are known."""

    keyword: str
    name: str


Statement = Signal | Param | Const | Let | Require | Certify
