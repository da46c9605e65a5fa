"""The units of most specifications and logs, as pint defines them: pint takes half a second to load.

A test compares each row with pint. A unit that is not here is looked up in pint.
"""

from __future__ import annotations

from fractions import Fraction

PI = Fraction("3.1415926535897932384626433832795028841971693993751")
"""Definition: π, with the digits of pint."""
_LENGTH, _MASS, _TIME = ("[length]", 1.0), ("[mass]", 1.0), ("[time]", 1.0)
_PER_TIME = (("[time]", -1.0),)
_ENERGY = (("[length]", 2.0), _MASS, ("[time]", -2.0))
_POWER = (("[length]", 2.0), _MASS, ("[time]", -3.0))
_ROWS: tuple[tuple[tuple[tuple[str, float], ...], float | None, dict[str, Fraction | int]], ...] = (
    ((_LENGTH,), None, {"m": 1, "cm": Fraction(1, 100), "mm": Fraction(1, 1000), "km": 1000}),
    ((_TIME,), 0.0, {"s": 1, "min": 60, "h": 3600, "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6)}),
    ((_TIME,), 0.0, {"ns": Fraction(1, 10**9)}),
    ((_MASS,), None, {"g": 1, "kg": 1000}),
    ((), 1.0, {"rad": 1, "deg": PI / 180, "turn": 2 * PI}),
    ((), 0.0, {"percent": Fraction(1, 100)}),
    (_PER_TIME, 0.0, {"Hz": 1, "kHz": 1000}),
    (_PER_TIME, 1.0, {"rpm": PI / 30}),
    ((_LENGTH, _MASS, ("[time]", -2.0)), None, {"N": 1000, "mN": 1, "kN": 10**6}),
    ((("[length]", -1.0), _MASS, ("[time]", -2.0)), None, {"Pa": 1000, "kPa": 10**6}),
    (_ENERGY, None, {"J": 1000}),
    (_POWER, None, {"W": 1000, "kW": 10**6}),
    ((("[current]", -1.0), *_POWER), None, {"V": 1000, "mV": 1}),
    ((("[current]", 1.0),), None, {"A": 1, "mA": Fraction(1, 1000)}),
    ((("[temperature]", 1.0),), None, {"K": 1, "degC": 1}),
)
"""Definition: dimension, exponent of the angle, and name → size in base units, of which the gram is one."""
_ZEROS = {"degC": Fraction("273.15")}
"""Definition: name → its zero in base units, where this is not 0."""
USUAL = {
    name: (dimension, Fraction(factor), _ZEROS.get(name, Fraction(0)), angle)
    for dimension, angle, factors in _ROWS
    for name, factor in factors.items()
}
"""Definition: name → dimension, factor, offset and angle, as :class:`s2r_spec.lang.units.Unit` takes them."""
