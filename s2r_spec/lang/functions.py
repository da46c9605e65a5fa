"""The built-in functions: how many arguments of which kind, and the unit of the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NoReturn, cast

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import suggestion
from s2r_spec.lang.scope import fail
from s2r_spec.lang.source import Span
from s2r_spec.lang.unify import combine, one, without_offset
from s2r_spec.lang.units import PLAIN

Argument = tuple[syntax.Expression, f.Value | f.Formula]


def call(expression: syntax.Call, arguments: Sequence[Argument]) -> f.Value | f.Formula:
    """Check a call whose arguments are checked already."""
    name = expression.function.text
    if name not in FUNCTIONS:
        guess = suggestion(name, FUNCTIONS)
        fail(
            "E16",
            f"there is no function `{name}`",
            expression.function.span,
            guess or f"there are {', '.join(sorted(FUNCTIONS))}",
        )
    make, fewest, most, usage = FUNCTIONS[name]
    if not fewest <= len(arguments) <= most:
        plural = "argument" if len(arguments) == 1 else "arguments"
        fail("E16", f"`{name}` does not take {len(arguments)} {plural}", expression.span, f"write `{usage}`")
    return make(name, expression.span, arguments)


def _numbers(name: str, arguments: Sequence[Argument]) -> list[f.Value]:
    values = []
    for written, argument in arguments:
        if isinstance(argument, f.Formula):
            _wrong_kind(written, f"`{name}` needs a number, and `{written.span.text}` is a condition")
        values.append(argument)
    return values


def _wrong_kind(written: syntax.Expression, message: str) -> NoReturn:
    fail("E05", message, written.span)


def _elementary(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    (operand,) = map(without_offset, _numbers(name, arguments))
    unit = operand.unit
    if name == "sign":
        unit = None if unit is None else PLAIN
    elif name == "sqrt":
        unit = None if unit is None else unit.power(0.5)
    function = cast(Literal["abs", "sign", "sqrt"], name)
    return f.Elementary(span=span, unit=unit, width=operand.width, function=function, operand=operand)


def _extremum(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    values, unit = combine([one(value) for value in _numbers(name, arguments)], span, f"take the {name} of")
    return f.Extremum(
        span=span, unit=unit, function=cast(Literal["min", "max"], name), operands=tuple(values)
    )


def _norm(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    values = [without_offset(value) for value in _numbers(name, arguments)]
    values, unit = combine(values, span, "take the norm of")
    return f.Norm(span=span, unit=unit, operands=tuple(values))


def _init(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    (operand,) = _numbers(name, arguments)
    return f.Initial(span=span, unit=operand.unit, width=operand.width, operand=operand)


def _overshoot(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    values = [without_offset(one(value)) for value in _numbers(name, arguments)]
    (signal, reference, *origin), unit = combine(values, span, "take the overshoot of")
    return f.Overshoot(
        span=span, unit=unit, signal=signal, reference=reference, origin=origin[0] if origin else None
    )


def _edge(name: str, span: Span, arguments: Sequence[Argument]) -> f.Formula:
    ((written, operand),) = arguments
    if isinstance(operand, f.Value):
        _wrong_kind(written, f"`{name}` needs a condition, and `{written.span.text}` is a number")
    return f.Edge(span=span, unit=operand.unit, operator=cast(Literal["rise", "fall"], name), operand=operand)


_MANY = 1000
_Make = Callable[[str, Span, Sequence[Argument]], f.Value | f.Formula]
FUNCTIONS: dict[str, tuple[_Make, int, int, str]] = {
    "abs": (_elementary, 1, 1, "abs(x)"),
    "sign": (_elementary, 1, 1, "sign(x)"),
    "sqrt": (_elementary, 1, 1, "sqrt(x)"),
    "min": (_extremum, 2, _MANY, "min(x, y)"),
    "max": (_extremum, 2, _MANY, "max(x, y)"),
    "norm": (_norm, 1, _MANY, "norm(u)` or `norm(x, y)"),
    "init": (_init, 1, 1, "init(x)"),
    "overshoot": (_overshoot, 2, 3, "overshoot(x, reference)` or `overshoot(x, reference, origin)"),
    "rise": (_edge, 1, 1, "rise(x >= 1)"),
    "fall": (_edge, 1, 1, "fall(x >= 1)"),
}
"""Name → how it is checked, fewest and most arguments, and how it is written."""
