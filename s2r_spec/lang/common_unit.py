"""Conversion of operands to a common unit, or the mistake that they have none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from s2r_spec.lang import formula as f
from s2r_spec.lang.scope import fail
from s2r_spec.lang.source import Span
from s2r_spec.lang.units import PLAIN, Unit


def convert(value: f.Value, unit: Unit) -> f.Value:
    """Return the same quantity in ``unit``, of the same dimension; a number without a unit takes it unchanged."""
    if value.unit is None:
        return replace(value, unit=unit)
    conversion = value.unit.to(unit)
    if conversion.same:
        return value
    return f.Convert(span=value.span, unit=unit, width=value.width, operand=value, conversion=conversion)


def combine(values: Sequence[f.Value], at: Span, verb: str) -> tuple[list[f.Value], Unit | None]:
    """Convert numbers to the unit of the first one that has a unit; return them and the unit of the result.

    Temperatures with an offset (degC) can be compared; their difference is in kelvin, and their sum is refused. A
    mistake stands ``at`` a place and names the operation by its ``verb`` ("compare").
    """
    unit = next((value.unit for value in values if value.unit is not None), None)
    if unit is None:
        return list(values), None
    for value in values:
        if value.unit is not None and not value.unit.fits(unit):
            _different(next(v for v in values if v.unit is not None), value, at, verb)
    if verb == "add":
        return [convert(without_offset(value), unit) for value in values], unit
    return [convert(value, unit) for value in values], unit.difference if verb == "subtract" else unit


def _different(left: f.Value, right: f.Value, at: Span, verb: str) -> None:
    assert left.unit is not None
    assert right.unit is not None
    link = "with" if verb == "compare" else "and"
    units = ("has no unit" if value.unit == PLAIN else f"is in {value.unit}" for value in (left, right))
    fix = ", ".join(f"`{_text(value)}` {unit}" for value, unit in zip((left, right), units, strict=True))
    if PLAIN in (left.unit, right.unit):
        fix += "; add a unit to its declaration"
    fix = left.unit.two_readings(right.unit) or fix
    fail("E03", f"cannot {verb} {left.unit} {link} {right.unit}", at, fix)


def _text(value: f.Value) -> str:
    text = " ".join(value.span.text.split())
    return text if len(text) <= 30 else text[:29] + "…"


def margins(formulas: Sequence[f.Formula]) -> tuple[tuple[f.Formula, ...], Unit | None]:
    """Convert margins of one dimension to one unit; margins of several dimensions stay unchanged, "mixed"."""
    unit = next((formula.unit for formula in formulas if formula.unit is not None), None)
    if unit is None:
        return tuple(formulas), None
    if any(formula.unit is not None and not formula.unit.fits(unit) for formula in formulas):
        return tuple(formulas), f.MIXED
    return tuple(_rescale(formula, unit) for formula in formulas), unit


def _rescale(formula: f.Formula, unit: Unit) -> f.Formula:
    if formula.unit is None or (factor := formula.unit.to(unit).factor) == 1.0:
        return formula
    return f.Rescale(span=formula.span, unit=unit, operand=formula, factor=factor)


def without_offset(value: f.Value) -> f.Value:
    """Return the value; fail if its unit has an arbitrary zero, such as degC."""
    if value.unit is not None and value.unit.offset:
        fail(
            "E20",
            f"`{_text(value)}` is in {value.unit}, whose zero is arbitrary; it can only be compared and subtracted",
            value.span,
            "declare it in {K}",
        )
    return value


def alike(left: f.Value, right: f.Value, span: Span) -> int:
    """Return the number of components of an operation on two values."""
    if left.width != right.width and 1 not in (left.width, right.width):
        fail("E17", f"one side has {left.width} components, the other {right.width}", span)
    return max(left.width, right.width)


def one(value: f.Value) -> f.Value:
    """Return the value; fail if it has more than one component."""
    if value.width != 1:
        text = _text(value)
        message = f"`{text}` is a vector of {value.width}, but a number is needed here"
        fail("E17", message, value.span, f"take `norm({text})` or one component")
    return value
