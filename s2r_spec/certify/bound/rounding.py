"""Bounds as text, rounded outward: a printed bound holds whenever the exact one does."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

# Enough for every digit that a double can have before the point and four after it.
_DIGITS = 330


def down(value: float, places: int = 4) -> str:
    """Return a lower bound with its sign and ``places`` decimals, rounded down: 0.00417 → "+0.0041"."""
    return _round(value, places, ROUND_FLOOR)


def up(value: float, places: int = 4) -> str:
    """Return an upper bound with its sign and ``places`` decimals, rounded up: −0.00417 → "-0.0041"."""
    return _round(value, places, ROUND_CEILING)


def interval_text(lower: float, upper: float) -> str:
    """Return both ends, rounded outward: ``[+0.0041, +0.0235]``."""
    return f"[{down(lower)}, {up(upper)}]"


def width_text(width: float, places: int = 4) -> str:
    """Return a width, rounded up, without a sign."""
    return up(width, places).lstrip("+")


def at_most(value: float, digits: int = 3) -> str:
    """Return an upper bound with ``digits`` significant digits, rounded up."""
    return _significant(value, digits, ROUND_CEILING)


def at_least(value: float, digits: int = 3) -> str:
    """Return a lower bound with ``digits`` significant digits, rounded down."""
    return _significant(value, digits, ROUND_FLOOR)


def _round(value: float, places: int, rounding: str) -> str:
    # From the shortest text of the double, as JSON has it: 0.1 stays 0.1.
    exact, context = Decimal(repr(float(value))), Context(prec=_DIGITS, rounding=rounding)
    return f"{exact.quantize(Decimal(1).scaleb(-places), context=context):+f}"


def _significant(value: float, digits: int, rounding: str) -> str:
    return f"{float(Context(prec=digits, rounding=rounding).create_decimal(repr(float(value)))):.{digits}g}"
