"""The response to one parameter, between and beyond the sizes at which it was simulated."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray

HARMONICS = 3
"""Definition: functions of the series of :class:`Turn`: cosine, sine, and the cosine of twice the angle."""
NEAR = 1e-3
"""Tolerance: below this coordinate a secant is the derivative at nominal."""


@dataclass(frozen=True, eq=False)
class ResponseCurve:
    """A monotone cubic between its points, a straight line beyond them.

    The cubic does not overshoot where an effect begins only at some size. Where it differs from the chord, the response
    between two points is not known: :meth:`bend` is this difference.

    Attributes:
        coordinates: (p,) rising; 0 is among them.
        values: (p, m) the response at each.
        noise: (p, m) variance of each value by the scatter of its runs; 0 at nominal.

    Source: Fritsch & Carlson, *SIAM Journal on Numerical Analysis* 17 (1980) 238.
    """

    coordinates: FloatArray
    values: FloatArray
    noise: FloatArray = field(default_factory=lambda: np.zeros(()))

    def at_points(self, kept: NDArray[np.bool_]) -> Self:
        """Return the curve through the points of (p,) a mask alone."""
        noise = np.broadcast_to(self.noise, self.values.shape)[kept]
        return replace(self, coordinates=self.coordinates[kept], values=self.values[kept], noise=noise)

    def at(self, coordinate: float) -> FloatArray:
        """Return (m,) the response."""
        known, value = self._last[0]
        if coordinate == known:
            return value
        if len(self._edges) < 2:
            return np.zeros(self.values.shape[1])
        inside = self._inside(coordinate)
        value = self._cubic(inside)
        if inside != coordinate:
            value = value + (coordinate - inside) * self._derivative(inside)
        self._last[0] = coordinate, value
        return value

    def slope(self, coordinate: float) -> FloatArray:
        """Return (m,) the derivative."""
        if len(self._edges) < 2:
            return np.zeros(self.values.shape[1])
        return self._derivative(self._inside(coordinate))

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
        return min(max(coordinate, self._edges[0]), self._edges[-1])

    def _cubic(self, coordinate: float) -> FloatArray:
        piece, s = self._piece(coordinate)
        c = self._cubics[piece]
        value: FloatArray = c[0] + c[1] * s + c[2] * (s * s) + c[3] * (s * s * s)
        return value

    def _derivative(self, coordinate: float) -> FloatArray:
        piece, s = self._piece(coordinate)
        c = self._derivatives[piece]
        slope: FloatArray = c[0] + c[1] * s + c[2] * (s * s)
        return slope

    def _piece(self, coordinate: float) -> tuple[int, float]:
        """Return the number of the piece of a coordinate, and how far this lies behind its begin."""
        piece = min(max(bisect_right(self._edges, coordinate) - 1, 0), len(self._edges) - 2)
        return piece, coordinate - self._edges[piece]

    @cached_property
    def _last(self) -> list[tuple[float, FloatArray]]:
        """The coordinate and the response of the last call: half of all calls are for the same again."""
        return [(np.nan, self.values[0])]

    @cached_property
    def _edges(self) -> list[float]:
        edges: list[float] = self.coordinates.tolist()
        return edges

    @cached_property
    def _cubics(self) -> FloatArray:
        """(pieces, 4, m) coefficients, the constants first. SciPy evaluates them in up to twice the time."""
        from scipy.interpolate import PchipInterpolator

        return np.ascontiguousarray(PchipInterpolator(self.coordinates, self.values).c[::-1].swapaxes(0, 1))

    @cached_property
    def _derivatives(self) -> FloatArray:
        return np.asarray(self._cubics[:, 1:] * np.array([1.0, 2.0, 3.0])[:, None])


@dataclass(frozen=True, eq=False)
class Turn(ResponseCurve):
    """The response to an angle of any value, with coordinates of half a turn: a Fourier series of period 2.

    Quarter turns show the first harmonic whole. Of the second they show the cosine, and not the sine: :meth:`bend` is a
    sine of the same amplitude.
    """

    def at(self, coordinate: float) -> FloatArray:
        """Return (m,) the response."""
        return np.asarray((self._basis(coordinate) - self._basis(0.0)) @ self._coefficients)

    def slope(self, coordinate: float) -> FloatArray:
        """Return (m,) the derivative."""
        x = np.pi * coordinate
        slopes = np.pi * np.array([-np.sin(x), np.cos(x), -2.0 * np.sin(2.0 * x)])
        return np.asarray(slopes[: len(self._coefficients)] @ self._coefficients)

    def secant(self, coordinate: float) -> FloatArray:
        """Return (m,) the derivative: an angle has no line from nominal."""
        return self.slope(coordinate)

    def bend(self, coordinate: float) -> FloatArray:
        """Return (m,) what the second harmonic may be beyond what the points show; 0 at the points."""
        if len(self._coefficients) < HARMONICS:
            return np.zeros(self.values.shape[1])
        return np.asarray(np.sin(2.0 * np.pi * coordinate) * self._coefficients[2])

    def _basis(self, coordinate: float) -> FloatArray:
        x = np.pi * coordinate
        return np.array([np.cos(x), np.sin(x), np.cos(2.0 * x)])[: min(self.coordinates.size - 1, HARMONICS)]

    @cached_property
    def _coefficients(self) -> FloatArray:
        """(h, m) of the functions of the basis. A point at which the machine fell is missing."""
        rows = np.array([self._basis(float(c)) - self._basis(0.0) for c in self.coordinates])
        if not rows.size:
            return np.zeros((0, self.values.shape[1]))
        return np.asarray(np.linalg.lstsq(rows, self.values, rcond=None)[0])


class Curves(tuple[ResponseCurve, ...]):
    """The responses to K parameters. Their cubics are evaluated together, since each has few numbers."""

    def at(self, theta: FloatArray) -> FloatArray:
        """Return (K, m) the responses at (K,) coordinates."""
        return np.asarray(self._both(theta)[0])

    def slope(self, theta: FloatArray) -> FloatArray:
        """Return (K, m) the derivatives at (K,) coordinates."""
        return np.asarray(self._both(theta)[1])

    def _both(self, theta: FloatArray) -> FloatArray:
        """Return (2, K, m) the responses and the derivatives; those of the last call are kept for the next."""
        if (key := theta.tobytes()) not in self._last:
            coordinates, found = theta.tolist(), np.empty((2, len(self), self[0].values.shape[1]))
            if cubics := self._together:
                inside = [self[k]._inside(coordinates[k]) for k in cubics]
                pieces = [self[k]._piece(x) for k, x in zip(cubics, inside, strict=True)]
                c = np.array([self[k]._cubics[piece] for k, (piece, _) in zip(cubics, pieces, strict=True)])
                s = np.array([behind for _, behind in pieces])[:, None]
                slope = c[:, 1] + (2.0 * c[:, 2]) * s + (3.0 * c[:, 3]) * (s * s)
                beyond = (theta[cubics] - inside)[:, None]
                found[0, cubics] = (
                    c[:, 0] + c[:, 1] * s + c[:, 2] * (s * s) + c[:, 3] * (s * s * s) + beyond * slope
                )
                found[1, cubics] = slope
            for k in sorted({*range(len(self))} - {*cubics}):
                found[:, k] = self[k].at(coordinates[k]), self[k].slope(coordinates[k])
            self._last.clear()
            self._last[key] = found
        return self._last[key]

    @cached_property
    def _together(self) -> list[int]:
        return [k for k, one in enumerate(self) if not isinstance(one, Turn) and one.coordinates.size > 1]

    @cached_property
    def _last(self) -> dict[bytes, FloatArray]:
        return {}
