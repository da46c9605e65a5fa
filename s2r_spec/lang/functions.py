"""The built-in functions: number and kind of their arguments, and the unit of the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, cast

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.common_unit import alike, combine, one, without_offset
from s2r_spec.lang.constants import constant
from s2r_spec.lang.diagnostics import suggestion
from s2r_spec.lang.scope import fail
from s2r_spec.lang.source import Span
from s2r_spec.lang.units import PLAIN, SECOND

Argument = tuple[syntax.Expression, f.Value | f.Formula]


def call(expression: syntax.Call, arguments: Sequence[Argument]) -> f.Value | f.Formula:
    """Check a call; its arguments were checked before."""
    name = expression.function.text
    if name not in FUNCTIONS:
        guess = suggestion(name, FUNCTIONS)
        message = f"there is no function `{name}`"
        fix = guess or f"the functions are {', '.join(sorted(FUNCTIONS))}"
        fail("E16", message, expression.function.span, fix)
    make, fewest, most, usage = FUNCTIONS[name]
    if not fewest <= len(arguments) <= most:
        plural = "argument" if len(arguments) == 1 else "arguments"
        fail("E16", f"`{name}` does not take {len(arguments)} {plural}", expression.span, f"write `{usage}`")
    return make(name, expression.span, arguments)


def _numbers(name: str, arguments: Sequence[Argument]) -> list[f.Value]:
    values = []
    for written, argument in arguments:
        if isinstance(argument, f.Formula):
            message = f"`{name}` needs a number, but `{written.span.text}` is a condition"
            fail("E05", message, written.span)
        values.append(argument)
    return values


def _elementary(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    (operand,) = map(without_offset, _numbers(name, arguments))
    unit = operand.unit
    if unit is not None and name != "abs":
        unit = PLAIN if name == "sign" else unit.power(0.5)
    function = cast(Literal["abs", "sign", "sqrt"], name)
    return f.Elementary(span=span, unit=unit, width=operand.width, function=function, operand=operand)


def _extremum(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    values, unit = combine([one(value) for value in _numbers(name, arguments)], span, f"take the {name} of")
    function = cast(Literal["min", "max"], name)
    return f.Extremum(span=span, unit=unit, function=function, operands=tuple(values))


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
    start = origin[0] if origin else None
    return f.Overshoot(span=span, unit=unit, signal=signal, reference=reference, origin=start)


def _edge(name: str, span: Span, arguments: Sequence[Argument]) -> f.Formula:
    operand = _condition(name, arguments[0])
    return f.Edge(span=span, unit=operand.unit, operator=cast(Literal["rise", "fall"], name), operand=operand)


def _delay(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    operand = _numbers(name, arguments[:1])[0]
    seconds, unit = _seconds(name, arguments[1:]), operand.unit
    return f.Delayed(span=span, unit=unit, width=operand.width, operand=operand, seconds=seconds)


def _deriv(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    (operand,) = _numbers(name, arguments)
    unit = (operand.unit or PLAIN).difference.over(SECOND)
    return f.Derivative(span=span, unit=unit, width=operand.width, operand=operand)


def _accumulate(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    operand = _numbers(name, arguments[:1])[0]
    function = cast(Literal["integral", "mean"], name)
    unit = operand.unit
    if function == "integral":
        operand = without_offset(operand)
        unit = SECOND if operand.unit is None else operand.unit.times(SECOND)
    seconds = _seconds(name, arguments[1:])
    return f.Accumulated(
        span=span, unit=unit, width=operand.width, function=function, operand=operand, seconds=seconds
    )


def _duration(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    return f.Duration(span=span, unit=SECOND, operand=_condition(name, arguments[0]))


def _count(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    seconds = _seconds(name, arguments[1:])
    return f.Count(span=span, unit=None, operand=_condition(name, arguments[0]), seconds=seconds)


def _if(name: str, span: Span, arguments: Sequence[Argument]) -> f.Value:
    condition = _condition(name, arguments[0])
    (left, right), unit = combine(_numbers(name, arguments[1:]), span, "choose between")
    width = alike(left, right, span)
    return f.Choice(span=span, unit=unit, width=width, condition=condition, left=left, right=right)


def _condition(name: str, argument: Argument) -> f.Formula:
    written, operand = argument
    if isinstance(operand, f.Value):
        fail("E05", f"`{name}` needs a condition, but `{written.span.text}` is a number", written.span)
    return operand


def _seconds(name: str, arguments: Sequence[Argument]) -> float:
    """Return the time that the last argument gives [s]; inf without it."""
    if not arguments:
        return math.inf
    ((written, _),) = arguments
    (checked,) = _numbers(name, arguments)
    unit, number = checked.unit or SECOND, constant(checked)
    if number is None or not math.isfinite(number) or number < 0:
        message = f"the time of `{name}` must be a non-negative constant, but `{written.span.text}` is not"
        fail("E18", message, written.span)
    if not unit.fits(SECOND):
        fail("E06", f"`{name}` needs a time, but `{written.span.text}` is in {unit}", written.span)
    return unit.to(SECOND)(number)


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
    "delay": (_delay, 2, 2, "delay(x, 0.1 {s})"),
    "deriv": (_deriv, 1, 1, "deriv(x)"),
    "integral": (_accumulate, 1, 2, "integral(x)` or `integral(x, 1 {s})"),
    "mean": (_accumulate, 1, 2, "mean(x)` or `mean(x, 1 {s})"),
    "duration": (_duration, 1, 1, "duration(x >= 1)"),
    "count": (_count, 1, 2, "count(rise(x >= 1))` or `count(rise(x >= 1), 1 {s})"),
    "if": (_if, 3, 3, "if(x >= 1, x, y)"),
}
"""Name → its check, the fewest and the most arguments, and its syntax."""
