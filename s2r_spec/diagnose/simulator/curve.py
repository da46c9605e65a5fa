"""The response to one parameter, between and beyond the sizes at which it was simulated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NEAR = 1e-3
"""Tolerance: below this coordinate a secant is the derivative at nominal. Twice as much changes nothing that shows."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A monotone cubic between its points, a straight line beyond them.

    The cubic does not overshoot where an effect begins only at some size. Where it differs from the chord, the response
    between two points is not known: :meth:`bend` is this difference.

    Attributes:
        coordinates: (p,) rising; 0 is among them.
        values: (p, m) the response at each.

    Source: Fritsch & Carlson, *SIAM Journal on Numerical Analysis* 17 (1980) 238.
    """

    coordinates: FloatArray
    values: FloatArray

    def at(self, coordinate: float) -> FloatArray:
        """Return (m,) the response."""
        if self.coordinates.size < 2:
            return np.zeros(self.values.shape[1])
        inside = self._inside(coordinate)
        value: FloatArray = self._cubic(inside)
        return value if inside == coordinate else value + (coordinate - inside) * self._derivative(inside)

    def slope(self, coordinate: float) -> FloatArray:
        """Return (m,) the derivative."""
        if self.coordinates.size < 2:
            return np.zeros(self.values.shape[1])
        return np.asarray(self._derivative(self._inside(coordinate)))

    def secant(self, coordinate: float) -> FloatArray:
        """Return (m,) the slope of the straight line from nominal; the derivative at nominal itself."""
        return self.at(coordinate) / coordinate if abs(coordinate) > NEAR else self.slope(0.0)

    def bend(self, coordinate: float) -> FloatArray:
        """Return (m,) the difference of the cubic and the chord; 0 at the points and beyond them."""
        c, v = self.coordinates, self.values
        if not c[0] < coordinate < c[-1]:
            return np.zeros(v.shape[1])
        place = int(np.searchsorted(c, coordinate, side="right")) - 1
        chord = v[place] + (v[place + 1] - v[place]) * (coordinate - c[place]) / (c[place + 1] - c[place])
        return np.asarray(self._cubic(coordinate) - chord)

    def _inside(self, coordinate: float) -> float:
        return float(min(max(coordinate, self.coordinates[0]), self.coordinates[-1]))

    @cached_property
    def _cubic(self) -> Any:
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(self.coordinates, self.values)

    @cached_property
    def _derivative(self) -> Any:
        return self._cubic.derivative()
