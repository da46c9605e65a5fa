"""Values of parameters as people give them: a number, a text with a unit (``"30 cm/s"``), or a pint Quantity."""

from __future__ import annotations

import re
from typing import Any, Protocol, runtime_checkable

from s2r_spec.base.errors import UsageError
from s2r_spec.lang.units import Unit, UnknownUnitError, parse_unit

NUMBER_AND_UNIT = r"(?P<number>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*\{?\s*(?P<unit>[^{}]*?)\s*\}?\s*"
_TEXT = re.compile(rf"\s*{NUMBER_AND_UNIT}")


@runtime_checkable
class PintQuantity(Protocol):
    """A number with a unit, as of pint."""

    @property
    def magnitude(self) -> Any:
        """The number."""

    @property
    def units(self) -> Any:
        """The unit."""


Amount = float | str | PintQuantity
"""A value of a parameter: a number in the declared unit, or a number with its own unit."""


def read_amount(value: Any, unit: Unit, name: str) -> float:
    """Return a value of the parameter ``name`` in a unit; a text without a unit is in ``unit``.

    Raises:
        UsageError: it is no :data:`Amount`, or its unit does not fit.
    """
    if type(value) is float:  # the common case, once for each rollout
        return value
    what = f"{name} = {str(value) if isinstance(value, PintQuantity) else repr(value)}"
    if isinstance(value, str):
        match = _TEXT.fullmatch(value)
        if match is None:
            example = f"0.3 {unit.text}".rstrip()
            raise UsageError(f"{what} is text, not a number with a unit such as {example!r}")
        return convert(float(match["number"]), match["unit"], unit, what, name)
    written = ""
    number = value
    if isinstance(value, PintQuantity):
        number, written = value.magnitude, f"{value.units:~C}".replace("dimensionless", "") or "1"
    try:
        number = float(number)
    except (TypeError, ValueError):
        raise UsageError(f"{what} is not a number") from None
    return convert(number, written, unit, what, name) if written else number


def convert(number: float, written: str, unit: Unit, what: str, name: str) -> float:
    """Return a number of the ``written`` unit ("" for the same) in another unit; ``what`` names the value in messages.

    Raises:
        UsageError: the text is not a unit, or has another dimension.
    """
    if not written:
        return number
    try:
        source = parse_unit(written)
    except UnknownUnitError:
        raise UsageError(f"{what}: {written!r} is not a unit") from None
    if not source.fits(unit):
        readings = source.two_readings(unit)
        raise UsageError(
            f"{what}: {written} does not convert to {unit}, the unit of {name!r}{readings and f'. {readings}'}"
        )
    return source.to(unit)(number)
