"""Numbers of a declaration or a setting: constant, finite, and in the declared unit."""

from __future__ import annotations

import math

from s2r_spec.lang import syntax
from s2r_spec.lang.common_unit import convert, one
from s2r_spec.lang.constants import constant
from s2r_spec.lang.expressions import value
from s2r_spec.lang.scope import Scope, fail
from s2r_spec.lang.units import Unit


def quantity(written: syntax.Expression, scope: Scope, unit: Unit | None, quantity_name: str) -> float:
    """Return a constant in ``unit``; a number without a unit is taken to be in it.

    Args:
        written: the expression.
        scope: the declarations above it.
        unit: the unit of the result; None for a number without a unit.
        quantity_name: name of the quantity for the message ("the range of `vd`").

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
