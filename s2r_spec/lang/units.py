"""Units: their dimensions, and the conversion of numbers between them.

Names, prefixes and factors come from pint, looked up one name at a time. Products, powers and comparisons are done
here on plain numbers, so a checked specification does not need pint. An angle has no dimension, as in the SI: rad/s
equals 1/s, and deg/s is converted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from s2r_spec.magnitude import LARGEST, SMALLEST

if TYPE_CHECKING:
    import pint

Dimension = tuple[tuple[str, float], ...]

_FACTOR = re.compile(r"\s*([A-Za-zµμΩ°%]+|1)\s*(?:(?:\^|\*\*)\s*(-?\d{1,2}))?\s*")
_JOINT = re.compile(r"[*·/]|(?=\S)")
# pint reads Nm as a unit of yarn; on a robot it is a torque
_ALSO = {"Nm": (("N", 1), ("m", 1)), "%": (("percent", 1),)}


LONGEST = 100
"""Budget: letters of a unit; the time to multiply names grows with their square."""


class UnknownUnitError(ValueError):
    """A text is not a unit; ``args[0]`` is the part that is wrong."""


@dataclass(frozen=True)
class Unit:
    """A unit of measurement.

    Args:
        text: the unit as it is written.
        dimension: ((base dimension, exponent), …), sorted; empty for a plain number.
        factor: size of the unit in base units.
        offset: the zero of the unit in base units, such as 273.15 for degC; 0 for nearly all units.
    """

    text: str
    dimension: Dimension = ()
    factor: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a unit that double precision cannot convert.

        Raises:
            OverflowError: the factor is too small or too large.
        """
        if not SMALLEST <= self.factor <= LARGEST:
            raise OverflowError(f"the unit {self.text} is too large or too small to convert")

    def __str__(self) -> str:
        return self.text or "no unit"

    def fits(self, other: Unit) -> bool:
        """Return whether both units have the same dimension."""
        return self.dimension == other.dimension

    def to(self, other: Unit) -> tuple[float, float]:
        """Return (a, b): a number x of this unit is a·x + b of the other one."""
        if (self.factor, self.offset) == (other.factor, other.offset):
            return 1.0, 0.0
        return self.factor / other.factor, (self.offset - other.offset) / other.factor

    @property
    def difference(self) -> Unit:
        """The unit of a difference of two numbers in this unit: K for degC."""
        return (
            Unit("K" if self.factor == 1.0 else f"delta_{self.text}", self.dimension, self.factor)
            if self.offset
            else self
        )

    def times(self, other: Unit) -> Unit:
        """Return the unit of a product."""
        if not other.text or not self.text:
            return other if not self.text else self
        return Unit(
            f"{self.text}*{other.text}",
            _combined(self.dimension, other.dimension, 1),
            self.factor * other.factor,
        )

    def over(self, other: Unit) -> Unit:
        """Return the unit of a quotient; the plain unit if both are the same, as in ``abs(tilt) / lean``."""
        if not other.text:
            return self
        if (self.dimension, self.factor, self.offset) == (other.dimension, other.factor, 0.0):
            return PLAIN
        below = f"({other.text})" if re.search(r"[*/·\s]", other.text) else other.text
        return Unit(
            f"{self.text or '1'}/{below}",
            _combined(self.dimension, other.dimension, -1),
            self.factor / other.factor,
        )

    def power(self, exponent: float) -> Unit:
        """Return the unit of a power."""
        if not self.text:
            return self
        if exponent == 0:
            return PLAIN
        dimension = tuple((name, n * exponent) for name, n in self.dimension)
        base = self.text if self.text.isalnum() else f"({self.text})"
        return Unit(f"{base}^{exponent:g}", dimension, self.factor**exponent)


PLAIN = Unit("")
"""The unit of a number without a unit."""

SECOND = Unit("s", (("[time]", 1.0),))


def parse_unit(text: str) -> Unit:
    """Return the unit of a text such as "m/s", "km / h" or "N m".

    Raises:
        UnknownUnitError: a name in it is not a unit.
    """
    if len(text) > LONGEST:
        raise UnknownUnitError(f"{text[:LONGEST]}…")
    return _parse(text.strip())


@cache
def _parse(text: str) -> Unit:
    if text in ("", "1"):
        return PLAIN
    parts = list(_parts(text))
    if len(parts) == 1 and parts[0][1] == 1:
        found = _named(parts[0][0])
        return Unit(text, found.dimension, found.factor, found.offset)
    unit = PLAIN
    for name, exponent in parts:
        found = _named(name)
        try:
            powered = Unit(name, found.dimension, found.factor).power(exponent) if name != "1" else PLAIN
            unit = unit.times(powered)
        except OverflowError:
            raise UnknownUnitError(text) from None
    return Unit(text, unit.dimension, unit.factor)


def _parts(text: str) -> list[tuple[str, int]]:
    """Return [("m", 1), ("s", -2)] for "m/s^2"; a quotient divides only by the next name."""
    parts: list[tuple[str, int]] = []
    position, sign = 0, 1
    while True:
        factor = _FACTOR.match(text, position)
        if factor is None:
            raise UnknownUnitError(text)
        exponent = sign * int(factor[2] or 1)
        parts += [(name, n * exponent) for name, n in _ALSO.get(factor[1], ((factor[1], 1),))]
        position = factor.end()
        if position == len(text):
            return parts
        joint = _JOINT.match(text, position)
        assert joint is not None
        position, sign = joint.end(), -1 if joint[0] == "/" else 1


@cache
def _named(name: str) -> Unit:
    """Return the unit of one name from pint; factors refer to pint's base units."""
    if name == "1":
        return PLAIN
    import pint

    registry = _registry()
    try:
        unit = registry.parse_units(name)
        zero, one, two = (_base(registry.Quantity(float(n), unit)) for n in (0, 1, 2))
    except (
        pint.PintError,
        ValueError,
        TypeError,
        AttributeError,
        OverflowError,
        ArithmeticError,
        RecursionError,
    ):
        raise UnknownUnitError(name) from None
    if abs(two - one - (one - zero)) > 1e-9 * abs(two - zero):
        raise UnknownUnitError(name)  # a logarithmic unit, such as dB
    dimensions: Mapping[str, Any] = unit.dimensionality
    dimension = tuple(sorted((base, float(n)) for base, n in dimensions.items() if n))
    try:
        return Unit(name, dimension, one - zero if zero else one, zero)
    except OverflowError:
        raise UnknownUnitError(name) from None


def _base(quantity: Any) -> float:
    return float(quantity.to_root_units().magnitude)


@cache
def _registry() -> pint.UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry()


def _combined(left: Dimension, right: Dimension, sign: int) -> Dimension:
    total = dict(left)
    for name, exponent in right:
        total[name] = total.get(name, 0.0) + sign * exponent
    return tuple(sorted((name, exponent) for name, exponent in total.items() if abs(exponent) > 1e-9))
