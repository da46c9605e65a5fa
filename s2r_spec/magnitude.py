"""Numbers that somebody declared: whether they are numbers, and whether double precision can work with them."""

from __future__ import annotations

import math
from typing import SupportsFloat

from s2r_spec.errors import UsageError

SMALLEST, LARGEST = 1e-100, 1e100
"""Least and largest size of a declared setting or length that is not 0 (definition; in the setting's own unit).

Bounds contain squares and quotients of squares of settings: within these sizes none of them
overflows or vanishes in double precision. With both exponents doubled some would.
"""


def number(name: str, value: object) -> float:
    """Return a finite number as a float.

    Args:
        name: what it is, for the sentence.
        value: a number of Python or NumPy.

    Raises:
        UsageError: it is no number, or not a finite one.
    """
    found = _float(name, value)
    if not math.isfinite(found):
        raise UsageError(f"{name} = {found:g}; it must be a finite number")
    return found


def positive(name: str, value: object) -> float:
    """Return a number > 0 that double precision can square.

    Raises:
        UsageError: it is something else.
    """
    found = _float(name, value)
    if not (math.isfinite(found) and found > 0):
        raise UsageError(f"{name} = {found:g}; it must be a positive number")
    if outside := beyond(found):
        raise UsageError(f"{name} = {found:g} is {outside}")
    return found


def whole(name: str, value: object, least: int) -> int:
    """Return a whole number ≥ ``least``.

    Raises:
        UsageError: it is something else.
    """
    found = _float(name, value)
    if not (math.isfinite(found) and found == int(found) and found >= least):
        raise UsageError(f"{name} = {found:g}; it must be a whole number, at least {least}")
    return int(value) if isinstance(value, int) else int(found)


def beyond(value: float) -> str:
    """Return what is wrong with the size of a number > 0, "" if nothing is."""
    if value < SMALLEST:
        return f"too small to be computed with: the least is {SMALLEST:g}"
    if value > LARGEST:
        return f"too large to be computed with: the most is {LARGEST:g}"
    return ""


def _float(name: str, value: object) -> float:
    if isinstance(value, bool | str | bytes) or not isinstance(value, SupportsFloat):
        raise UsageError(f"{name} = {value!r} is not a number")
    try:
        return float(value)
    except OverflowError:
        return math.inf
    except (TypeError, ValueError):
        raise UsageError(f"{name} = {value!r} is not a number") from None
