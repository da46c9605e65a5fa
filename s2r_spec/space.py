"""The test space D: a box of test parameters, with names and units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError, one_of, suggest
from s2r_spec.base.magnitude import beyond, number

ROUNDED = 1e-9
"""Tolerance: part of a range by which a value may be outside, after a conversion of units and back."""

FINEST = 1e-9
"""Tolerance: least width of a range, relative to its ends. A search halves a range 20 times and more, and double
precision has 16 digits. Twice as much changes nothing for ranges in use."""

Key = tuple[tuple[str, float], ...]


def key_of(test: Mapping[str, float]) -> Key:
    """Return a dictionary key of a test, which does not depend on the order of its parameters."""
    return tuple(sorted(test.items()))


@dataclass(frozen=True)
class Axis:
    """One test parameter, with its range in its unit ("" if it has none)."""

    name: str
    low: float
    high: float
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse an empty or infinite range, and one whose width overflows."""
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise UsageError(
                f"the range of {self.name!r} is [{self.low:g}, {self.high:g}]; "
                f"it needs two finite numbers, the lower one first"
            )
        if not math.isfinite(self.width):
            raise UsageError(
                f"the range of {self.name!r}, [{self.low:g}, {self.high:g}], is wider than the largest number"
            )

    @property
    def width(self) -> float:
        """Length of the range, in the axis' unit."""
        return self.high - self.low

    @property
    def unfit(self) -> str:
        """The reason why a search cannot divide this range; "" if it can."""
        if outside := beyond(self.width):
            return f"the width of the range of {self.name!r} is {outside}"
        if self.width < FINEST * max(abs(self.low), abs(self.high)):
            return (
                f"the range of {self.name!r} is {self.width:.3g} wide at {self.high:.17g}: double precision cannot "
                f"divide it; declare the parameter as a difference from a fixed value"
            )
        return ""


@dataclass(frozen=True)
class Space:
    """A box: the product of its axes, in declared order."""

    axes: tuple[Axis, ...]

    @classmethod
    def of(cls, ranges: Mapping[str, tuple[float, float]], units: Mapping[str, str] | None = None) -> Space:
        """Build a box from ranges ``{"vd": (-0.2, 0.3)}`` and units ``{"vd": "m/s"}``."""
        units = units or {}
        if not isinstance(ranges, Mapping):
            raise UsageError(f'a test space is a mapping like {{"vd": (-0.2, 0.3)}}, not {ranges!r}')
        return cls(
            tuple(Axis(str(name), *_ends(name, ends), units.get(name, "")) for name, ends in ranges.items())
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in declared order."""
        return tuple(axis.name for axis in self.axes)

    @property
    def units(self) -> dict[str, str]:
        """Parameter name → unit."""
        return {axis.name: axis.unit for axis in self.axes}

    @property
    def dim(self) -> int:
        """Number of parameters."""
        return len(self.axes)

    @property
    def lower(self) -> FloatArray:
        """(dim,) lower corner."""
        return np.array([axis.low for axis in self.axes])

    @property
    def upper(self) -> FloatArray:
        """(dim,) upper corner."""
        return np.array([axis.high for axis in self.axes])

    def at(self, unit: FloatArray) -> FloatArray:
        """Return (..., dim) points of the box from points of the unit cube; the ends and 0 are exact."""
        points = np.clip(self.lower + unit * (self.upper - self.lower), self.lower, self.upper)
        rounding = 4.0 * np.finfo(float).eps * np.maximum(np.abs(self.lower), np.abs(self.upper))
        return np.where(np.abs(points) < rounding, 0.0, points)

    def point(self, vector: FloatArray) -> dict[str, float]:
        """Return the test of a (dim,) vector: parameter → value."""
        return {name: float(value) for name, value in zip(self.names, vector, strict=True)}

    def vector(self, point: Mapping[str, float]) -> FloatArray:
        """Return the (dim,) vector of a test; a value outside the box by rounding only is moved to its end.

        Raises:
            UsageError: a name is unknown or missing, or a value is outside the box.
        """
        for name in point:
            if name not in self.names:
                raise UsageError(
                    f"{name!r} is not a parameter of this test space"
                    f"{suggest(name, self.names)} it has {one_of(self.names)}"
                )
        for axis in self.axes:
            if axis.name not in point:
                raise UsageError(f"the test parameter {axis.name!r} is missing from {dict(point)}")
            room = ROUNDED * axis.width
            number(axis.name, point[axis.name])
            if not axis.low - room <= point[axis.name] <= axis.high + room:
                raise UsageError(
                    f"{axis.name} = {point[axis.name]:g} {axis.unit} is outside "
                    f"[{axis.low:g}, {axis.high:g}] {axis.unit}"
                )
        return np.clip([float(point[name]) for name in self.names], self.lower, self.upper)

    def grid(self, counts: tuple[int, ...]) -> FloatArray:
        """Return (prod(counts), dim) grid points, with both ends of every axis, last axis fastest."""
        lines = [np.linspace(axis.low, axis.high, n) for axis, n in zip(self.axes, counts, strict=True)]
        return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, self.dim)


def _ends(name: object, ends: Any) -> tuple[float, float]:
    try:
        low, high = ends
    except (TypeError, ValueError):
        raise UsageError(
            f"the range of {name!r} is {ends!r}; it needs two numbers, the lower one first"
        ) from None
    end = f"an end of the range of {name!r}"
    return _number(end, low), _number(end, high)


def _number(name: str, value: object) -> float:
    # The axis refuses an infinite end, with a message about the whole range.
    return float(value) if isinstance(value, float) else number(name, value)
