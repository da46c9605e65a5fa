"""Units: their dimensions, and the conversion of numbers between them.

Names, prefixes and exact factors are pint's, looked up one name at a time: the usual ones in a table, others in pint
itself. Products, powers and comparisons are done here on plain numbers, so a checked specification does not need pint.
An angle has no dimension, as in the SI: rad/s · m is m/s, and deg/s is converted. A rotation is no frequency, though:
1 rpm is 1 turn or 6.28 rad a minute, and ``1/min`` does not say of which. The units remember which they are, as far as
they can.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

from s2r_spec.base.magnitude import LARGEST, SMALLEST
from s2r_spec.lang.conversion import Conversion
from s2r_spec.lang.usual_units import USUAL

if TYPE_CHECKING:
    import pint

Dimension = tuple[tuple[str, float], ...]

_FACTOR = re.compile(
    r"\s*(?:(?P<one>1)(?![\w.-])|(?P<name>(?:[^\W\d_]|[°%])+(?:\d+[^\W\d_]+)*)(?P<digits>-[1-9]|[2-9](?!\d))?)"
    r"\s*(?:(?:\^|\*\*)\s*(?P<opening>[({])?(?P<power>[+-]?\d{1,2})(?(opening)[)}]))?\s*"
)
_JOINT = re.compile(r"[*·/]|\.(?=[^\W\d_])|-(?=[^\W\d_])|(?<=\s)(?=\S)")
_SIGNS = str.maketrans("−⋅∙•×∕", "-····/")
"""Definition: signs of products, quotients and exponents that are written in several ways."""
_ALSO = {"Nm": (("N", 1), ("m", 1)), "%": (("percent", 1),), "rev": (("turn", 1),)}
"""Definition: names that pint lacks, and Nm, which pint reads as a unit of yarn; on a robot it is a torque."""
_NONE = frozenset(("", "1", "-", "–", "—"))
"""Definition: texts that say that a number has no unit."""
_WORD = 3
"""Definition: letters of the shortest name that may be in capital letters; in shorter ones they tell M from m."""
_SECOND_MEANING = {
    "g": "gravity", "G": "gravity", "mg": "milligravity", "C": "degC", "F": "degF",
}  # fmt: skip
"""Definition: symbols in logs that also stand for another unit: g is the gram, and a scale of acceleration."""


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
        angle: exponent of the angle in it: 1 for rad/s, 0 for Hz. None if the unit does not tell: a radius may be in
            m or in m/rad, and a number without a unit may be an angle.
    """

    text: str
    dimension: Dimension = ()
    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)
    angle: float | None = 0.0

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
        """Return whether numbers in one unit can be converted to the other one."""
        return self.dimension == other.dimension and not self._turns_against(other)

    def _turns_against(self, other: Unit) -> bool:
        """Return whether one is a rotation in time, such as rpm, and the other a frequency, such as 1/min."""
        return (
            self.dimension == other.dimension
            and [base for base, _ in self.dimension] == ["[time]"]
            and None not in (self.angle, other.angle)
            and (self.angle == 0) != (other.angle == 0)
        )

    def two_readings(self, other: Unit) -> str:
        """Return both readings of a rotation as a frequency, and what to write instead; "" for any other pair."""
        if not self._turns_against(other):
            return ""
        turning, frequency = (other, self) if self.angle == 0 else (self, other)
        ratio = float(turning.factor / frequency.factor)
        turns = ratio / math.tau ** (turning.angle or 0.0)
        if frequency.text.startswith("1/"):
            per = frequency.text[1:]
        else:
            per = "/s" if frequency.text == "Hz" else f"*{frequency.text}"
        return (
            f"1 {turning} is {turns:.4g} {frequency} if turns are counted, and {ratio:.4g} {frequency} if radians are. "
            f"Instead of {frequency} write rev{per} for turns, or rad{per} for radians"
        )

    def to(self, other: Unit) -> Conversion:
        """Return the conversion of numbers of this unit to the other one."""
        return Conversion(self.factor / other.factor, (self.offset - other.offset) / other.factor)

    @property
    def difference(self) -> Unit:
        """The unit of a difference of two numbers in this unit: K for degC."""
        if not self.offset:
            return self
        text = "K" if self.factor == 1 else f"delta_{self.text}"
        return Unit(text, self.dimension, self.factor, angle=self.angle)

    def times(self, other: Unit) -> Unit:
        """Return the unit of a product; a factor without a unit may be an angle."""
        if not other.text or not self.text:
            return replace(self if self.text else other, angle=None)
        return Unit(
            f"{self.text}*{other.text}",
            _combine(self.dimension, other.dimension, 1),
            self.factor * other.factor,
            angle=_sum(self.angle, other.angle, 1),
        )

    def over(self, other: Unit) -> Unit:
        """Return the unit of a quotient; the plain unit if both are the same, as in ``abs(tilt) / lean``."""
        if not other.text:
            return replace(self, angle=None)
        if (self.dimension, self.factor) == (other.dimension, other.factor) and not self.offset:
            return PLAIN
        below = f"({other.text})" if re.search(r"[*/·\s]", other.text) else other.text
        return Unit(
            f"{self.text or '1'}/{below}",
            _combine(self.dimension, other.dimension, -1),
            self.factor / other.factor,
            angle=_sum(self.angle, other.angle, -1),
        )

    def power(self, exponent: float) -> Unit:
        """Return the unit of a power."""
        if not self.text:
            return self
        if exponent == 0:
            return PLAIN
        dimension = tuple((name, n * exponent) for name, n in self.dimension)
        base = self.text if self.text.isalnum() else f"({self.text})"
        angle = None if self.angle is None else self.angle * exponent
        return Unit(f"{base}^{exponent:g}", dimension, _power(self.factor, exponent), angle=angle)


PLAIN = Unit("", angle=None)
"""The unit of a number without a unit."""

SECOND = Unit("s", (("[time]", 1.0),))


def parse_unit(text: str) -> Unit:
    """Return the unit of a text such as "m/s", "km / h", "N m", "m/s²", "m s-1" or "-".

    Raises:
        UnknownUnitError: a name in it is not a unit.
    """
    if len(text) > LONGEST:
        raise UnknownUnitError(f"{text[:LONGEST]}…")
    return _parse(text.strip())


def unit_in_log(text: str, declared: Unit) -> Unit:
    """Return the unit that a log states for a declared quantity: "g" is the gravity of Earth for an acceleration.

    Raises:
        UnknownUnitError: the text is not a unit.
    """
    logged = parse_unit(text)
    if not logged.fits(declared) and text.strip() in _SECOND_MEANING:
        other = parse_unit(_SECOND_MEANING[text.strip()])
        return replace(other, text=text.strip()) if other.fits(declared) else logged
    return logged


@lru_cache(1024)
def is_unit(text: str) -> bool:
    """Return whether a text in brackets after a name is a unit, and not the number of a component."""
    try:
        return bool(parse_unit(text).dimension) or not text.strip().isdigit()
    except UnknownUnitError:
        return False


@cache
def _parse(text: str) -> Unit:
    if text in _NONE:
        return PLAIN
    parts = list(_parts(unicodedata.normalize("NFKC", text).translate(_SIGNS)))
    if len(parts) == 1 and parts[0][1] == 1:
        return replace(_find_unit(parts[0][0]), text=text)
    unit = Unit("1")
    for name, exponent in parts:
        try:
            unit = unit.times(replace(_find_unit(name), offset=Fraction(0)).power(exponent))
        except OverflowError:
            raise UnknownUnitError(text) from None
    return replace(unit, text=text)


def _parts(text: str) -> list[tuple[str, int]]:
    """Return [("m", 1), ("s", -2)] for "m/s^2"; a quotient divides only by the next name."""
    parts: list[tuple[str, int]] = []
    position, sign = 0, 1
    while True:
        factor = _FACTOR.match(text, position)
        if factor is None or (factor["digits"] and factor["power"]):
            raise UnknownUnitError(text)
        exponent = sign * int(factor["digits"] or factor["power"] or 1)
        if not factor["one"]:
            also = _ALSO.get(factor["name"], ((factor["name"], 1),))
            parts += [(name, n * exponent) for name, n in also]
        position = factor.end()
        if position == len(text):
            return parts
        joint = _JOINT.match(text, position)
        if joint is None:
            raise UnknownUnitError(text)
        position, sign = joint.end(), -1 if joint[0] == "/" else 1


@cache
def _find_unit(name: str) -> Unit:
    """Return the unit of one name, ``RPM`` like ``rpm``; factors refer to pint's base units."""
    try:
        return _find_spelling(name)
    except UnknownUnitError:
        if len(name) < _WORD or name == name.lower():
            raise
    try:
        return _find_spelling(name.lower())
    except UnknownUnitError:
        raise UnknownUnitError(name) from None


def _find_spelling(name: str) -> Unit:
    """Return the unit of one name, in capital and small letters as they are."""
    return Unit(name, *USUAL[name]) if name in USUAL else unit_of_pint(name)


def unit_of_pint(name: str) -> Unit:
    """Return the unit of one name as pint defines it.

    Raises:
        UnknownUnitError: pint has no such unit, or it has no constant size.
    """
    import pint

    registry = _registry()
    try:
        unit = registry.parse_units(name)
        (zero, _), (one, roots), (two, _) = (_root(registry.Quantity(Fraction(n), unit)) for n in (0, 1, 2))
    except (pint.PintError, ValueError, TypeError, AttributeError, ArithmeticError, RecursionError):
        raise UnknownUnitError(name) from None
    if abs(two - one - (one - zero)) > 1e-9 * abs(two - zero):
        raise UnknownUnitError(name)  # a logarithmic unit, such as dB
    dimensions: Mapping[str, Any] = unit.dimensionality
    dimension = tuple(sorted((base, float(n)) for base, n in dimensions.items() if n))
    timed = all(base == "[time]" for base, _ in dimension)
    try:
        return Unit(name, dimension, one - zero, zero, float(roots.get("radian", 0)) if timed else None)
    except OverflowError:
        raise UnknownUnitError(name) from None


def _root(quantity: Any) -> tuple[Fraction, dict[str, Any]]:
    """Return a quantity in base units: its number, and base unit → exponent; an angle's base unit is the radian."""
    root = quantity.to_root_units()
    return Fraction(root.magnitude), dict(root.unit_items())


@cache
def _registry() -> pint.UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry(non_int_type=Fraction)


def _power(factor: Fraction, exponent: float) -> Fraction:
    """Return a power of a factor; exactly, if the exponent is whole or a square root is rational."""
    if exponent == 0.5:
        roots = [math.isqrt(factor.numerator), math.isqrt(factor.denominator)]
        if Fraction(*roots) ** 2 == factor:
            return Fraction(*roots)
    return factor ** int(exponent) if float(exponent).is_integer() else Fraction(float(factor) ** exponent)


def _sum(left: float | None, right: float | None, sign: int) -> float | None:
    return None if left is None or right is None else left + sign * right


def _combine(left: Dimension, right: Dimension, sign: int) -> Dimension:
    total = dict(left)
    for name, exponent in right:
        total[name] = total.get(name, 0.0) + sign * exponent
    return tuple(sorted((name, exponent) for name, exponent in total.items() if abs(exponent) > 1e-9))
