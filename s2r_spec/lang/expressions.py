"""The check of expressions: it resolves names, separates conditions from numbers, and converts units."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import cast

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.common_unit import alike, combine, margins, one, without_offset
from s2r_spec.lang.constants import constant
from s2r_spec.lang.declarations import Param, Signal
from s2r_spec.lang.functions import call
from s2r_spec.lang.intervals import EVER, interval
from s2r_spec.lang.scope import Scope, both, each, fail, unit_of
from s2r_spec.lang.source import Span
from s2r_spec.lang.units import PLAIN

Checked = f.Value | f.Formula


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
        fail(
            "E05",
            f"`{_short(expression)}` is a number, but {operator} needs a condition",
            expression.span,
            "compare it with something, such as `x >= 0`",
        )
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
            return f.Elementary(
                span=span, unit=operand.unit, width=operand.width, function="minus", operand=operand
            )
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
        fail(
            "E17",
            f"`{name}` is not a vector signal",
            expression.span,
            "declare a vector as in `signal u[3]`",
            signal.span,
        )
    if not index.value.is_integer() or not 0 <= index.value < signal.dim:
        fail(
            "E17",
            f"`{name}` has the components {name}[0] to {name}[{signal.dim - 1}]",
            index.span,
            "components are numbered from 0",
            signal.span,
        )
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
        parts.append(
            f.Comparison(
                span=_link(expression, k),
                unit=unit.difference if unit else None,
                operator=cast(f.CompareOp, word.text),
                left=converted[0],
                right=converted[1],
            )
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
        lambda: _within(expression.interval, span, scope),
        lambda: condition(expression.operand, scope, f"`{operator}`"),
    )
    return f.Temporal(span=span, unit=inner.unit, operator=operator, interval=within, operand=inner)


def _within(written: syntax.Interval | None, span: Span, scope: Scope) -> f.Interval:
    return EVER(span) if written is None else interval(written, scope, value)


def _until(expression: syntax.Until, scope: Scope) -> f.Formula:
    # rules/chained_until.py reports a chain of several
    link, span = expression.links[0], expression.span
    within, operands = both(
        lambda: _within(link.interval, span, scope),
        lambda: _conditions((expression.left, link.operand), scope, link.operator),
    )
    (left, right), rho = margins(operands)
    return f.Until(span=span, unit=rho, operator=link.operator, interval=within, left=left, right=right)


def _short(expression: syntax.Expression) -> str:
    text = " ".join(expression.span.text.split())
    return text if len(text) <= 40 else text[:39] + "…"
