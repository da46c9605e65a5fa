"""Where in the test space the gap lies: a Gaussian process over it, and what follows from its samples.

The process is put on the signed gap E Δρ, which is smooth; E|Δρ| has a kink wherever
the gap changes its sign, and follows from it as the mean of a folded normal
distribution. The worst test, the band that holds everywhere at once and the set of
tests with too large a gap are read off functions that are sampled from its posterior.
Where an improved simulator foretells the gap, the process is also put on what that
leaves; functions are then drawn from either process as often as its evidence says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.where import gaps as seen
from s2r_spec.diagnose.where.gaps import GapAt
from s2r_spec.diagnose.where.process import Data, functions
from s2r_spec.errors import UsageError
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

LEVEL = 0.95
FUNCTIONS = 2000
"""Samples of the gap as a function."""
MOST_FORETOLD = 0.75
"""Largest part of these that an improved simulator foretells: it was fitted to the rollouts that are its evidence."""
_COUNTS = {1: (101,), 2: (21, 21), 3: (7, 7, 7), 4: (5, 5, 5, 5)}
MOST_AXES = max(_COUNTS)
"""Of a test space in which can be said where the gap lies."""


@dataclass(frozen=True, eq=False)
class Foretold:
    """The gap as an improved simulator has it: E ρ of that, less E ρ of the simulator.

    Attributes:
        seen: (n,) at the tests that were run.
        grid: (m,) at the places of :func:`grid_of`.
    """

    seen: FloatArray
    grid: FloatArray


@dataclass(frozen=True, eq=False)
class Band:
    """A function over the test space, known so far.

    Attributes:
        mean: (m,) at the places of the grid.
        lower: (m,) with probability 0.95 the function is above it everywhere.
        upper: (m,) and, with the same 0.95, below this.
    """

    mean: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True, eq=False)
class InSpace:
    """Where in the test space the gap lies.

    Attributes:
        space: the test space.
        unit: of ρ.
        tests: what was seen.
        grid: (m, dim) places.
        absolute: E|Δρ| there.
        signed: E Δρ there; negative where the real machine is worse.
        floor: E|Δρ| of the simulator against itself; NaN if no test was simulated twice.
        worst: the test where E|Δρ| is probably largest.
        near: probability that the largest E|Δρ| is within a tenth of every axis of ``worst``.
        worst_in: name → (low, high), the box that holds the central 90 % of where it may be.
        largest: (estimate, low, high) of E|Δρ| at its worst, 95 %.
        tolerance: a gap below it does not matter: twice the floor; None where that is not known.
        exceeds: (m,) probability that E|Δρ| is above the tolerance; None where there is none.
        notes: what the data do not allow, in sentences.
    """

    space: Space
    unit: str
    tests: tuple[GapAt, ...]
    grid: FloatArray
    absolute: Band
    signed: Band
    floor: float
    worst: Mapping[str, float]
    near: float
    worst_in: Mapping[str, tuple[float, float]]
    largest: tuple[float, float, float]
    tolerance: float | None
    exceeds: FloatArray | None
    notes: tuple[str, ...]

    @property
    def beyond(self) -> NDArray[np.bool_] | None:
        """(m,) places at which the gap exceeds the tolerance with probability 0.95 or more; None where it has none."""
        return None if self.exceeds is None else self.exceeds >= LEVEL

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON: of the band, a line along each axis through the worst test."""
        estimate, low, high = self.largest
        return {
            "worst": dict(self.worst),
            "worst_probability": self.near,
            "worst_within": {name: list(ends) for name, ends in self.worst_in.items()},
            "largest": {"estimate": estimate, "low": low, "high": high, "unit": self.unit},
            "floor": None if np.isnan(self.floor) else self.floor,
            "tolerance": self.tolerance,
            "beyond": None if self.beyond is None else _share_and_box(self.space, self.grid, self.beyond),
            "along": {name: self._line(place) for place, name in enumerate(self.space.names)},
            "notes": list(self.notes),
        }

    def along(self, axis: int) -> NDArray[np.intp]:
        """Return the places of the grid on the line along an axis through the worst test."""
        worst = self.space.vector(self.worst)
        others = [k for k in range(self.space.dim) if k != axis]
        on = np.isclose(self.grid[:, others], worst[others]).all(axis=1)
        return np.flatnonzero(on)

    def _line(self, axis: int) -> dict[str, list[float] | None]:
        on = self.along(axis)
        return {
            "at": self.grid[on, axis].tolist(),
            "absolute": self.absolute.mean[on].tolist(),
            "absolute_low": self.absolute.lower[on].tolist(),
            "absolute_high": self.absolute.upper[on].tolist(),
            "signed": self.signed.mean[on].tolist(),
            "signed_low": self.signed.lower[on].tolist(),
            "signed_high": self.signed.upper[on].tolist(),
            "exceeds": None if self.exceeds is None else self.exceeds[on].tolist(),
        }


def _share_and_box(space: Space, grid: FloatArray, beyond: NDArray[np.bool_]) -> dict[str, Any]:
    """Return which part of the grid is beyond the tolerance, and the box that holds it."""
    there = grid[beyond]
    ends = zip(there.min(axis=0).tolist(), there.max(axis=0).tolist(), strict=True) if there.size else ()
    return {
        "share": float(beyond.mean()),
        "within": {name: list(end) for name, end in zip(space.names, ends, strict=False)},
    }


def grid_of(space: Space) -> FloatArray:
    """Return (m, dim) places that are looked at.

    Raises:
        UsageError: the space has no or more than four parameters.
    """
    if space.dim not in _COUNTS:
        raise UsageError(
            f"s2r locates the gap in a test space of one to four parameters, and the spec has {space.dim}"
        )
    return space.grid(_COUNTS[space.dim])


def in_space(
    space: Space,
    tests: tuple[GapAt, ...],
    unit: str = "",
    seed: int = 0,
    foretold: Foretold | None = None,
) -> InSpace:
    """Return where in the test space the gap lies.

    Args:
        space: the test space, of one to four parameters.
        tests: what was seen, one entry a test.
        unit: of ρ.
        seed: of the sampled functions.
        foretold: the gap as an improved simulator has it, if there is one.

    Raises:
        UsageError: there is no test, or the space has no or more than four parameters.
    """
    if not tests:
        raise UsageError(
            "s2r needs at least one real rollout to locate the gap in the test space, and there is none"
        )
    grid = grid_of(space)
    at = np.array([space.vector(test.params) for test in tests])
    generator = np.random.default_rng(seed)
    data = seen.measured(tests)
    sign = _sampled(
        Data(_unit(space, at), data.mean, data.deviation), _unit(space, grid), foretold, generator
    )
    size = seen.folded(sign, data.scatter)
    largest = size.max(axis=1)
    places = grid[size.argmax(axis=1)]
    worst = _mode(space, places)
    low, high = np.quantile(places, [0.05, 0.95], axis=0)
    floor = seen.floor(tests)
    tolerance = 2.0 * floor if np.isfinite(floor) else None
    return InSpace(
        space,
        unit,
        tests,
        grid,
        _band(size, positive=True),
        _band(sign),
        floor,
        space.point(worst),
        float((np.abs(places - worst) <= 0.1 * (space.upper - space.lower) + 1e-12).all(axis=1).mean()),
        {n: (float(a), float(b)) for n, a, b in zip(space.names, low, high, strict=True)},
        (float(np.median(largest)), *np.quantile(largest, [0.025, 0.975]).tolist()),
        tolerance,
        None if tolerance is None else (size > tolerance).mean(axis=0),
        _notes(space, tests),
    )


def _sampled(
    data: Data, grid: FloatArray, foretold: Foretold | None, generator: np.random.Generator
) -> FloatArray:
    """Return (FUNCTIONS, m) of the signed gap, from its own process and from that on what was not foretold."""
    plain, evidence = functions(data, grid, FUNCTIONS, generator)
    if foretold is None:
        return plain
    rest = replace(data, values=data.values - foretold.seen)
    left, other = functions(rest, grid, FUNCTIONS, generator)
    share = 1.0 / (1.0 + np.exp(np.clip(evidence - other, -50.0, 50.0)))
    count = round(FUNCTIONS * min(float(share), MOST_FORETOLD))
    # Functions of one size and length scale lie side by side: any count of them is taken from all.
    picked = generator.permutation(FUNCTIONS)
    return np.concatenate([foretold.grid + left[picked[:count]], plain[picked[count:]]])


def _unit(space: Space, points: FloatArray) -> FloatArray:
    scaled: FloatArray = (points - space.lower) / (space.upper - space.lower)
    return scaled


def _band(sampled: FloatArray, positive: bool = False) -> Band:
    """Return the band around the mean that holds LEVEL of the functions as a whole."""
    mean, deviation = sampled.mean(axis=0), sampled.std(axis=0)
    width = np.quantile((np.abs(sampled - mean) / np.maximum(deviation, 1e-300)).max(axis=1), LEVEL)
    lower = mean - width * deviation
    return Band(mean, np.maximum(lower, 0.0) if positive else lower, mean + width * deviation)


def _mode(space: Space, places: FloatArray) -> FloatArray:
    """Return that of the places around which they are densest, by a triangle of a tenth of every axis."""
    distinct, counts = np.unique(_unit(space, places), axis=0, return_counts=True)
    near = np.clip(1.0 - 10.0 * np.abs(distinct[:, None] - distinct), 0.0, None).prod(axis=2) @ counts
    return space.at(distinct[near.argmax()])


def _notes(space: Space, tests: tuple[GapAt, ...]) -> tuple[str, ...]:
    notes = []
    if 3 * seen.replicated(tests) < len(tests):
        notes.append(
            f"{seen.replicated(tests)} of {len(tests)} tests have three or more real rollouts; repeat a third of the "
            f"tests to separate noise from the shape of the gap"
        )
    if len(tests) < 2 * space.dim + 1:
        notes.append(
            f"the gap was measured at {len(tests)} test{'s' * (len(tests) != 1)} of a space with {space.dim} "
            f"parameter{'s' * (space.dim != 1)}; elsewhere it is a guess"
        )
    return tuple(notes)
