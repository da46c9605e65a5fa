"""The check of expressions: it resolves names, separates conditions from numbers, and converts units."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import cast

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.common_unit import alike, combine, convert, margins, one, without_offset
from s2r_spec.lang.constants import constant
from s2r_spec.lang.declarations import Param, Signal
from s2r_spec.lang.functions import call
from s2r_spec.lang.scope import Mistake, Scope, both, each, fail, unit_of
from s2r_spec.lang.source import Span
from s2r_spec.lang.units import PLAIN, SECOND, Unit

Checked = f.Value | f.Formula

_TIMES = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_PER_SECOND = {"ns": 1e9, "us": 1e6, "ms": 1e3}


def value(expression: syntax.Expression, scope: Scope) -> f.Value:
    """Check an expression that must be a number (or a vector)."""
    checked = check(expression, scope)
    if isinstance(checked, f.Formula):
        fail("E05", f"`{_short(expression)}` is a condition, but a number is needed here", expression.span)
    return checked


def condition(expression: syntax.Expression, scope: Scope, operator: str) -> f.Formula:
    """Check an expression that must be a condition; ``operator`` needs it and is named in the message."""
    checked = check(expression, scope)
    if isinstance(checked, f.Value):
        message = f"`{_short(expression)}` is a number, but {operator} needs a condition"
        fail("E05", message, expression.span, "compare it with something, such as `x >= 0`")
    return checked


def check(expression: syntax.Expression, scope: Scope) -> Checked:
    """Check any expression.

    Raises:
        Mistake: it is wrong; the rest of its statement is not checked.
    """
    span = expression.span
    match expression:
        case syntax.Number():
            if abs(expression.value) == float("inf"):
                fail("E18", f"`{span.text}` is too large for a number", span)
            unit = None if expression.unit is None else unit_of(expression.unit)
            return f.Number(span=span, unit=unit, value=expression.value)
        case syntax.Name():
            return _name(expression, scope)
        case syntax.Index():
            return _index(expression, scope)
        case syntax.Call():
            return call(
                expression, each(lambda argument: (argument, check(argument, scope)), expression.arguments)
            )
        case syntax.Truth():
            return f.Truth(span=span, unit=None, value=expression.value)
        case syntax.Minus():
            operand = without_offset(value(expression.operand, scope))
            unit, width = operand.unit, operand.width
            return f.Elementary(span=span, unit=unit, width=width, function="minus", operand=operand)
        case syntax.Arithmetic():
            try:
                return _arithmetic(expression, scope)
            except OverflowError:
                fail("E03", f"the unit of `{_short(expression)}` is too large or too small to convert", span)
        case syntax.Comparison():
            return _comparison(expression, scope)
        case syntax.Negation():
            inner = condition(expression.operand, scope, "`not`")
            return f.Not(span=span, unit=inner.unit, operand=inner)
        case syntax.Junction():
            operands, rho = margins(_conditions(expression.operands, scope, expression.operator))
            return f.Junction(span=span, unit=rho, operator=expression.operator, operands=operands)
        case syntax.Implication():
            pair = (expression.left, expression.right)
            (left, right), rho = margins(_conditions(pair, scope, expression.operator))
            return f.Implication(span=span, unit=rho, operator=expression.operator, left=left, right=right)
        case syntax.Temporal():
            return _temporal(expression, scope)
        case syntax.Until():
            return _until(expression, scope)
        case syntax.AdjacentSample():
            inner = condition(expression.operand, scope, f"`{expression.operator}`")
            return f.AdjacentSample(span=span, unit=inner.unit, operator=expression.operator, operand=inner)


def _name(expression: syntax.Name, scope: Scope) -> Checked:
    declared, span = scope.find(expression.name, expression.span), expression.span
    if isinstance(declared, Signal):
        if declared.boolean:
            return f.Flag(span=span, unit=None, name=declared.name)
        return f.SignalValue(span=span, unit=declared.measure, width=declared.dim, name=declared.name)
    if isinstance(declared, Param):
        return f.ParamValue(span=span, unit=declared.measure, name=declared.name)
    if isinstance(declared.body, f.Formula):
        return f.Named(span=span, unit=declared.body.unit, name=expression.name, operand=declared.body)
    return replace(declared.body, span=span)


def _conditions(expressions: Iterable[syntax.Expression], scope: Scope, operator: str) -> list[f.Formula]:
    return each(lambda expression: condition(expression, scope, f"`{operator}`"), expressions)


def _index(expression: syntax.Index, scope: Scope) -> f.Value:
    name, index = expression.name.text, expression.index
    signal = scope.find(name, expression.name.span)
    if not isinstance(signal, Signal) or not signal.vector:
        fix = "declare a vector as in `signal u[3]`"
        fail("E17", f"`{name}` is not a vector signal", expression.span, fix, signal.span)
    if not index.value.is_integer() or not 0 <= index.value < signal.dim:
        message = f"`{name}` has the components {name}[0] to {name}[{signal.dim - 1}]"
        fail("E17", message, index.span, "components are numbered from 0", signal.span)
    return f.SignalValue(span=expression.span, unit=signal.measure, name=name, index=int(index.value))


def _arithmetic(expression: syntax.Arithmetic, scope: Scope) -> f.Value:
    left, right = each(lambda operand: value(operand, scope), (expression.left, expression.right))
    symbol, span = expression.operator.text, expression.span
    operator = cast(f.ArithmeticOp, symbol)
    width = alike(left, right, span)
    if symbol in "+-":
        verb = "add" if symbol == "+" else "subtract"
        pair, unit = combine([left, right], expression.operator.span, verb)
        return f.Arithmetic(span=span, unit=unit, width=width, operator=operator, left=pair[0], right=pair[1])
    left, right = without_offset(left), without_offset(right)
    if symbol == "^":
        exponent = constant(right)
        if exponent is None or not abs(exponent) <= 9 or right.unit not in (None, PLAIN):
            fail("E18", "an exponent must be a constant from -9 to 9, without a unit", right.span)
        unit = None if left.unit is None else left.unit.power(exponent)
    elif right.unit is None:
        unit = left.unit
    elif symbol == "*":
        unit = right.unit if left.unit is None else left.unit.times(right.unit)
    else:
        unit = (left.unit or PLAIN).over(right.unit)
    return f.Arithmetic(span=span, unit=unit, width=width, operator=operator, left=left, right=right)


def _comparison(expression: syntax.Comparison, scope: Scope) -> f.Formula:
    operands = each(lambda operand: value(operand, scope), expression.operands)
    parts: list[f.Formula] = []
    for k, word in enumerate(expression.operators):
        left, right = operands[k : k + 2]
        converted, unit = combine([one(left), one(right)], word.span, "compare")
        operator, unit = cast(f.CompareOp, word.text), unit.difference if unit else None
        left, right = converted
        parts.append(
            f.Comparison(span=_link(expression, k), unit=unit, operator=operator, left=left, right=right)
        )
    if len(parts) == 1:
        return parts[0]
    both, rho = margins(parts)
    return f.Junction(span=expression.span, unit=rho, operator="and", operands=both)


def _link(expression: syntax.Comparison, k: int) -> Span:
    """Return the place of one comparison of a chain, with the brackets around its operands."""
    words, whole = expression.operators, expression.span
    start = words[k - 1].span.end if k else whole.start
    end = words[k + 1].span.start if k + 1 < len(words) else whole.end
    text = whole.source.text[start:end]
    return Span(whole.source, start + len(text) - len(text.lstrip()), start + len(text.rstrip()))


def _temporal(expression: syntax.Temporal, scope: Scope) -> f.Formula:
    operator, span = expression.operator, expression.span
    within, inner = both(
        lambda: _interval(expression.interval, span, scope),
        lambda: condition(expression.operand, scope, f"`{operator}`"),
    )
    return f.Temporal(span=span, unit=inner.unit, operator=operator, interval=within, operand=inner)


def _until(expression: syntax.Until, scope: Scope) -> f.Formula:
    # rules/chained_until.py reports a chain of several
    link, span = expression.links[0], expression.span
    within, operands = both(
        lambda: _interval(link.interval, span, scope),
        lambda: _conditions((expression.left, link.operand), scope, link.operator),
    )
    (left, right), rho = margins(operands)
    return f.Until(span=span, unit=rho, operator=link.operator, interval=within, left=left, right=right)


def _short(expression: syntax.Expression) -> str:
    text = " ".join(expression.span.text.split())
    return text if len(text) <= 40 else text[:39] + "…"


@dataclass(frozen=True)
class _End:
    """One end: its least and greatest time [s], and the parameter that sets it, if any."""

    least: float
    greatest: float
    param: f.ParamTime | None = None


def _interval(written: syntax.Interval | None, place: Span, scope: Scope) -> f.Interval:
    """Check an interval: its ends are constants or parameters, in order; without one it is the rest of the trace."""
    if written is None:
        return f.Interval(0.0, math.inf, True, False, place)
    start, end = _end(written.low, scope), _end(written.high, scope)
    low, high = start.least, end.greatest
    if low < 0 or end.least < 0:
        past = "use `historically`, `once` or `since` for the past"
        fail("E06", f"the interval begins at {low:g} s, in the past", written.low.span, past)
    if high < low:
        message = f"the interval is empty: it ends at {high:g} s, before it begins at {low:g} s"
        fail("E06", message, written.span)
    if high == low and not (written.low_closed and written.high_closed):
        message = f"the interval is empty: it excludes {low:g} s, its only instant"
        fail("E06", message, written.span, "write `[a, a]`")
    # other tools write "inf]"; no instant is at infinity
    high_closed = written.high_closed and not math.isinf(high)
    return f.Interval(low, high, written.low_closed, high_closed, written.span, start.param, end.param)


def _end(bound: syntax.Bound, scope: Scope) -> _End:
    if bound.value is None:
        return _End(math.inf, math.inf)
    checked = value(bound.value, scope)
    if not isinstance(checked, f.ParamValue):
        number = constant(checked)
        if number is None:
            text = bound.value.span.text
            message = f"a time bound must be a constant or a parameter, but `{text}` is neither"
            fail("E18", message, bound.value.span)
        if not math.isfinite(number):
            fail("E18", f"`{bound.value.span.text}` is not a finite number", bound.value.span)
        seconds = _seconds(bound, checked, number)
        return _End(seconds, seconds)
    param = scope.find(checked.name, bound.value.span)
    assert isinstance(param, Param)
    ends = param.range or (param.default, param.default)
    if ends[0] is None or ends[1] is None:
        raise Mistake  # neither range nor default: reported before
    least, greatest, factor = (_seconds(bound, checked, number) for number in (ends[0], ends[1], 1.0))
    return _End(least, greatest, f.ParamTime(checked.name, factor))


def _seconds(bound: syntax.Bound, checked: f.Value, number: float) -> float:
    assert bound.value is not None
    unit: Unit = checked.unit or SECOND
    if bound.unit is not None:
        if bound.unit.text not in _TIMES:
            message = f"`{bound.unit.text}` is not a unit of time"
            fail("E04", message, bound.unit.span, "use ns, us, ms, s, min or h")
        if checked.unit not in (None, PLAIN):
            fail("E06", f"the bound has two units, {checked.unit} and {bound.unit.text}", bound.span)
        # 100/1000 is the closest number to a tenth, and 100·0.001 need not be
        small = _PER_SECOND.get(bound.unit.text)
        return number / small if small else number * _TIMES[bound.unit.text]
    if isinstance(checked, f.ParamValue) and unit == PLAIN:
        return number
    if not unit.fits(SECOND):
        message = f"a time bound must be a time, but `{bound.value.span.text}` is in {unit}"
        fail("E06", message, bound.value.span)
    return unit.to(SECOND)(number)


def quantity(written: syntax.Expression, scope: Scope, unit: Unit | None, quantity_name: str) -> float:
    """Return a constant in ``unit``, None for none; a number without a unit is taken to be in it.

    Messages call it ``quantity_name`` ("the range of `vd`").

    Raises:
        Mistake: it is not constant, not finite, or in a unit that does not fit.
    """
    checked = one(value(written, scope))
    if checked.unit is not None and (unit is None or not checked.unit.fits(unit)):
        expected = "without a unit" if unit is None else f"in {unit}"
        fail("E03", f"{quantity_name} must be {expected}, not in {checked.unit}", written.span)
    number = constant(checked if unit is None else convert(checked, unit))
    if number is None:
        fail("E18", f"{quantity_name} must be a constant, but `{written.span.text}` is not", written.span)
    if not math.isfinite(number):
        fail("E18", f"`{written.span.text}` is not a finite number", written.span)
    return number


def range_of(written: syntax.Range | None, scope: Scope, unit: Unit, name: str) -> tuple[float, float] | None:
    """Return (low, high) of a range in ``unit``, or None if there is none."""
    if written is None:
        return None
    low = quantity(written.low, scope, unit, f"the range of `{name}`")
    high = quantity(written.high, scope, unit, f"the range of `{name}`")
    if low >= high:
        fail("E09", f"the range of `{name}` is empty: {low:g} is not below {high:g}", written.span)
    return low, high
