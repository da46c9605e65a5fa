"""Columns of a log without a unit: which are refused, and which are noted because they may be misread."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from s2r_spec.base.errors import TraceError
from s2r_spec.lang.declarations import Signal
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.logs.times.time_units import split_brackets

_SI = {
    (unit.dimension, bool(unit.angle)): unit.text
    for unit in map(parse_unit, ("rad/s", "1/s", "m", "m/s", "m/s^2", "s", "K", "rad"))
}
"""Definition: (dimension, whether it is of an angle) → unit of SI that a sentence shows as an example."""


def no_units(
    signals: Mapping[str, Signal], units: Mapping[str, str], columns: Mapping[str, str]
) -> list[str]:
    """Return a sentence for each column with a text in brackets that is no unit, where the signal has one.

    ``units`` are those of signals in the log, and ``columns`` those of signals or components.
    """
    mapped = [(key.partition("[")[0], column) for key, column in columns.items()]
    return [
        f"{column!r} is read in {signals[name].unit}, because {split[1]!r} is not a unit; if that is wrong, state "
        f"its unit, such as --map '{name}={column} [{signals[name].unit}]'"
        for name, column in mapped
        if name in signals and signals[name].unit and name not in units
        if (split := split_brackets(column)) is not None and not split[1].isdigit()
    ]


def refuse_unit_in_name(
    signals: Mapping[str, Signal], units: Mapping[str, str], columns: Mapping[str, str]
) -> None:
    """Refuse a column without a unit whose name ends in another unit of the signal's quantity: ``pitch_deg`` for rad.

    Raises:
        TraceError: there is one.
    """
    for name, signal in signals.items():
        column = columns.get(name, name)
        word = re.split(r"[^0-9A-Za-z°µ%]+", column)[-1]
        if units.get(name) or not signal.unit or word in (column, name, ""):
            continue
        try:
            written = parse_unit(word)
        except UnknownUnitError:
            continue
        measured = signal.measure.dimension or signal.measure.angle
        if measured and written.fits(signal.measure) and not written.to(signal.measure).same:
            raise TraceError(
                f"the name {column!r} ends in the unit {word}, but its numbers would be read in {signal.unit}; state "
                f"the unit, such as --map '{name}={column} [{word}]'"
            )


def assumptions(
    signals: Mapping[str, Signal], units: Mapping[str, str], columns: Mapping[str, str]
) -> list[str]:
    """Return a sentence for each signal without a unit in the log whose declared unit is not that of SI.

    Robots' logs are in SI units as a rule (REP 103 of ROS), so that a declaration in degrees is likely to misread them.
    """
    mapped = {name: columns.get(name, name) for name in signals if not units.get(name)}
    sentences = [
        assumption(column, signals[name].unit, f"--map '{name}={column} [UNIT]'")
        for name, column in mapped.items()
    ]
    return list(filter(None, sentences))


def assumption(column: str, declared: str, remedy: str) -> str:
    """Return a sentence on a column without a unit that is read in a declared unit; "" if this is of SI.

    ``remedy`` is the option that states the unit, with UNIT in its place.
    """
    unit = parse_unit(declared)
    mass = dict(unit.dimension).get("[mass]", 0.0)
    if math.isclose(unit.factor, 1000.0**mass) and not unit.offset:
        return ""
    known = unit.dimension or "deg" in declared
    turning = bool(unit.angle) or not unit.dimension
    likely = _SI.get((unit.dimension, turning), "UNIT") if known else "UNIT"
    return (
        f"{column} has no unit in the log, and is read in {declared}; if that is wrong, state its unit, such as "
        f"{remedy.replace('UNIT', likely)}"
    )
