"""Quantities as people write them: digits by the uncertainty, an SI prefix for small values, units with a dot.

Rounding follows the Particle Data Group (*Review of Particle Physics*, introduction, section 5.3): an uncertainty has
two digits if its first three are 100 to 354, else one, and the value ends at the same decimal.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from s2r_spec.base.printable import spell_unit

SMALL = 0.01
"""Definition: a quantity below it [in its unit] gets an SI prefix."""
SYMMETRIC = 0.1
"""Tolerance: difference of both half-widths, in parts of their mean, up to which an interval is written with ±."""
MOST_PLACES = 6
"""Definition: decimals from which on a quantity without a prefix is written with an exponent."""
_PREFIXES = (("m", 1e-3), ("µ", 1e-6), ("n", 1e-9))
_PREFIXABLE = re.compile(r"(?:m|s|N|V|A|W|J|Pa|Hz)(?=$|[/*])")


@dataclass(frozen=True)
class Scale:
    """A unit with a prefix.

    Attributes:
        factor: the factor of the unit without the prefix.
        unit: the printed unit.
    """

    factor: float
    unit: str

    @classmethod
    def of(cls, largest: float, unit: str) -> Scale:
        """Return the scale for quantities up to ``largest`` [unit]."""
        size = abs(largest)
        if 0.0 < size < SMALL and _PREFIXABLE.match(unit):
            prefix, factor = next((one for one in _PREFIXES if size >= one[1]), _PREFIXES[-1])
            return cls(factor, prefix + spell_unit(unit))
        return cls(1.0, spell_unit(unit))

    def number(self, value: float, uncertainty: float) -> str:
        """Return a value [unit without prefix] with the digits that its uncertainty leaves; three if it has none."""
        return _round(value / self.factor, uncertainty / self.factor)


def quantity(value: float, unit: str, uncertainty: float = 0.0) -> str:
    """Return a value with its unit: ``12 µm``."""
    scale = Scale.of(value, unit)
    return f"{scale.number(value, uncertainty)} {scale.unit}".rstrip()


def signed_quantity(value: float, unit: str) -> str:
    """Return a value with its sign and unit: ``−12 µm``."""
    return f"{'−' if value < 0.0 else '+'}{quantity(abs(value), unit)}"


def interval(low: float, high: float, unit: str, exact: bool = False) -> str:
    """Return an interval with its unit: ``0.51 to 0.69 N·m``; exact ends have three digits."""
    scale, half = Scale.of(max(abs(low), abs(high)), unit), 0.0 if exact else (high - low) / 2
    return f"{scale.number(low, half)} to {scale.number(high, half)} {scale.unit}".rstrip()


def format_estimate(value: float, low: float, high: float, unit: str) -> str:
    """Return an estimate with its interval: ``0.60 ± 0.09 N·m``, or ``1.5 N (1.1 to 2.2 N)`` if it is lopsided."""
    half = (high - low) / 2
    if half <= 0.0:
        return quantity(value, unit)
    if abs(high + low - 2.0 * value) > SYMMETRIC * half:
        return f"{middle(value, low, high, unit)} ({interval(low, high, unit)})"
    scale = Scale.of(max(abs(low), abs(high)), unit)
    return f"{scale.number(value, half)} ± {scale.number(half, half)} {scale.unit}".rstrip()


def middle(value: float, low: float, high: float, unit: str) -> str:
    """Return the value of an estimate, with the digits and the prefix of its interval."""
    scale = Scale.of(max(abs(low), abs(high)), unit)
    return f"{scale.number(value, (high - low) / 2)} {scale.unit}".rstrip()


def _round(value: float, uncertainty: float) -> str:
    if not (uncertainty > 0.0 and math.isfinite(uncertainty) and math.isfinite(value)):
        return f"{value:.3g}"
    exponent = math.floor(math.log10(uncertainty))
    places = (1 if round(uncertainty / 10.0 ** (exponent - 2)) < 355 else 0) - exponent
    if places > MOST_PLACES:
        return f"{value:.2g}"
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}"  # no "-0"
