"""Check declared numbers: finite, of the right sign, and of a size that double precision can handle."""

from __future__ import annotations

import math
from typing import SupportsFloat

from s2r_spec.base.errors import UsageError

SMALLEST, LARGEST = 1e-100, 1e100
"""Definition: smallest and largest size of a setting or length other than 0, in its own unit.

Bounds contain squares of settings and quotients of squares. Within these sizes none of them overflows or underflows in
double precision.
"""


def number(name: str, value: object) -> float:
    """Return a finite number as a float.

    Raises:
        UsageError: the value is not a finite number.
    """
    real = _float(name, value)
    if not math.isfinite(real):
        raise UsageError(f"{name} = {real:g}; it must be a finite number")
    return real


def positive(name: str, value: object) -> float:
    """Return a number > 0 that double precision can square.

    Raises:
        UsageError: the value is not such a number.
    """
    real = _float(name, value)
    if not (math.isfinite(real) and real > 0):
        raise UsageError(f"{name} = {real:g}; it must be a positive number")
    if fault := beyond(real):
        raise UsageError(f"{name} = {real:g} is {fault}")
    return real


def whole(name: str, value: object, least: int) -> int:
    """Return a whole number ≥ ``least``.

    Raises:
        UsageError: the value is not such a number.
    """
    real = _float(name, value)
    if not (math.isfinite(real) and real == int(real) and real >= least):
        raise UsageError(f"{name} = {real:g}; it must be a whole number, at least {least}")
    return int(value) if isinstance(value, int) else int(real)


def beyond(value: float) -> str:
    """Return the fault in the size of a number > 0; "" if there is none."""
    if value < SMALLEST:
        return f"too small for double precision; it must be at least {SMALLEST:g}"
    if value > LARGEST:
        return f"too large for double precision; it must be at most {LARGEST:g}"
    return ""


def _float(name: str, value: object) -> float:
    if isinstance(value, bool | str | bytes) or not isinstance(value, SupportsFloat):
        raise UsageError(f"{name} = {value!r}; it must be a number")
    try:
        return float(value)
    except OverflowError:
        return math.inf
    except (TypeError, ValueError):
        raise UsageError(f"{name} = {value!r}; it must be a number") from None
