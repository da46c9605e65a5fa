"""The test space D: a box of test parameters, with names and units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import UsageError, one_of, suggest

FloatArray = NDArray[np.float64]

ROUNDED = 1e-9
"""Part of its range by which a value may be outside: units were converted, there and back."""


Key = tuple[tuple[str, float], ...]


def key_of(test: Mapping[str, float]) -> Key:
    """Return what equal tests have in common, whatever the order of their parameters: a key for a dictionary."""
    return tuple(sorted(test.items()))


@dataclass(frozen=True)
class Axis:
    """One test parameter: its range in its unit ("" when it has none)."""

    name: str
    low: float
    high: float
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse an empty or infinite range."""
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise UsageError(
                f"the range of {self.name!r} is [{self.low:g}, {self.high:g}]; "
                f"it needs two finite numbers, the lower one first"
            )

    @property
    def width(self) -> float:
        """Length of the range, in the axis' unit."""
        return self.high - self.low


@dataclass(frozen=True)
class Space:
    """A box: the product of its axes, in declared order."""

    axes: tuple[Axis, ...]

    @classmethod
    def of(cls, ranges: Mapping[str, tuple[float, float]], units: Mapping[str, str] | None = None) -> Space:
        """Build a box from ``{"vd": (-0.2, 0.3)}`` and, if wanted, ``{"vd": "m/s"}``."""
        units = units or {}
        return cls(
            tuple(
                Axis(name, float(low), float(high), units.get(name, ""))
                for name, (low, high) in ranges.items()
            )
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
        """Return (..., dim) points of the box, from points of the unit cube: ends, and 0, exactly."""
        found = np.clip(self.lower + unit * (self.upper - self.lower), self.lower, self.upper)
        rounding = 4.0 * np.finfo(float).eps * np.maximum(np.abs(self.lower), np.abs(self.upper))
        return np.where(np.abs(found) < rounding, 0.0, found)

    def point(self, vector: FloatArray) -> dict[str, float]:
        """Name the coordinates of a (dim,) vector."""
        return {name: float(value) for name, value in zip(self.names, vector, strict=True)}

    def vector(self, point: Mapping[str, float]) -> FloatArray:
        """Return the (dim,) vector of a named point; what a rounding has put outside of the box is at its end.

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
            if not axis.low - room <= point[axis.name] <= axis.high + room:
                raise UsageError(
                    f"{axis.name} = {point[axis.name]:g} {axis.unit} is outside "
                    f"[{axis.low:g}, {axis.high:g}] {axis.unit}"
                )
        return np.clip([float(point[name]) for name in self.names], self.lower, self.upper)

    def grid(self, counts: tuple[int, ...]) -> FloatArray:
        """Return (prod(counts), dim) grid points, both ends of every axis included, last axis fastest."""
        lines = [np.linspace(axis.low, axis.high, n) for axis, n in zip(self.axes, counts, strict=True)]
        return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, self.dim)
