"""The gap over the test space, from a Gaussian process.

Data: Δρ (n,) at the tests that were run, with standard errors from replicates. Unknown: the signed gap g(x) = E Δρ at
every test x. Model: g is a Gaussian process (:mod:`~s2r_spec.diagnose.gap.gaussian_process`), or the prediction of an
improved simulator plus such a process. Both models have a weight in proportion to their evidence. Estimator: functions
that are sampled from the posterior. The expected size E|Δρ| follows from g and the scatter, as the mean of a folded
normal distribution. The worst test, the band and the tests above the tolerance are statistics of the sampled functions.

Units: those of ρ. Shapes: n tests, m places of a grid over the space, DRAWS functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.gap import DRAWS, LEVEL, observed
from s2r_spec.diagnose.gap.gaussian_process import Data, functions
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest
from s2r_spec.diagnose.gap.test_space import grid_of, in_cube
from s2r_spec.errors import UsageError
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

MOST_PREDICTED = 0.75
"""Prior: largest weight of the improved simulator, because it was fitted to the same rollouts. At 1, it may be
alone."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """The gap that an improved simulator predicts: its ρ minus ρ of the nominal simulator.

    Attributes:
        tests: (n,) at the tests that were run.
        grid: (m,) at the places of :func:`grid_of`.
    """

    tests: FloatArray
    grid: FloatArray


@dataclass(frozen=True, eq=False)
class Band:
    """A simultaneous band: with probability 0.95 a function is between its limits at all places.

    Attributes:
        mean: (m,) at the places of the grid.
        lower: (m,) lower limit.
        upper: (m,) upper limit.
    """

    mean: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True, eq=False)
class GapSurface:
    """The gap over the test space.

    Attributes:
        space: the test space.
        unit: the unit of ρ.
        tests: ρ at the tests that were run.
        grid: (m, dim) places.
        absolute: E|Δρ| there.
        signed: E Δρ there; negative where the real machine is worse.
        floor: E|Δρ| of the simulator against itself; NaN if no test was simulated twice.
        worst: the test where E|Δρ| is probably largest.
        near: probability that the largest E|Δρ| is within a tenth of every axis of ``worst``.
        worst_in: name → (low, high), the box with the central 90 % of the posterior of the worst test.
        largest: (estimate, low, high) of E|Δρ| at its worst, 95 %.
        tolerance: twice the floor; None if the floor is not known.
        exceeds: (m,) probability that E|Δρ| is above the tolerance; None without a tolerance.
        notes: limits of the data, in sentences.
    """

    space: Space
    unit: str
    tests: tuple[RolloutsAtTest, ...]
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
        """(m,) places where the gap exceeds the tolerance with probability 0.95 or more; None without a tolerance."""
        return None if self.exceeds is None else self.exceeds >= 1.0 - LEVEL

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
        found = {"at": self.grid[on, axis].tolist()}
        for name, band in (("absolute", self.absolute), ("signed", self.signed)):
            for ending, values in (("", band.mean), ("_low", band.lower), ("_high", band.upper)):
                found[name + ending] = values[on].tolist()
        return found | {"exceeds": None if self.exceeds is None else self.exceeds[on].tolist()}


def _share_and_box(space: Space, grid: FloatArray, beyond: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the part of the grid beyond the tolerance, and the smallest box around it."""
    there = grid[beyond]
    ends = zip(there.min(axis=0).tolist(), there.max(axis=0).tolist(), strict=True) if there.size else ()
    return {
        "share": float(beyond.mean()),
        "within": {name: list(end) for name, end in zip(space.names, ends, strict=False)},
    }


def gap_surface(
    space: Space,
    tests: tuple[RolloutsAtTest, ...],
    unit: str = "",
    seed: int = 0,
    predicted: Predicted | None = None,
) -> GapSurface:
    """Return the gap over the test space.

    Args:
        space: the test space, of one to four parameters.
        tests: ρ at the tests that were run, one entry for each test.
        unit: the unit of ρ.
        seed: of the sampled functions.
        predicted: the gap that an improved simulator predicts; None without one.

    Raises:
        UsageError: there is no test, or the space has no or more than four parameters.
    """
    if not tests:
        raise UsageError(
            "s2r needs at least one real rollout to locate the gap in the test space, and there is none"
        )
    grid = grid_of(space)
    at = in_cube(space, np.array([space.vector(test.params) for test in tests]))
    generator = np.random.default_rng(seed)
    mean, deviation, scatter = observed.measured(tests)
    sign = _sampled(Data(at, mean, deviation), in_cube(space, grid), predicted, generator)
    size = observed.folded(sign, scatter)
    largest = size.max(axis=1)
    places = grid[size.argmax(axis=1)]
    worst = _mode(space, places)
    low, high = np.quantile(places, [0.05, 0.95], axis=0)
    floor = observed.floor(tests)
    tolerance = 2.0 * floor if np.isfinite(floor) else None
    return GapSurface(
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
    data: Data, grid: FloatArray, predicted: Predicted | None, generator: np.random.Generator
) -> FloatArray:
    """Return (DRAWS, m) samples of the signed gap, from both models in proportion to their evidence."""
    plain, evidence = functions(data, grid, DRAWS, generator)
    if predicted is None:
        return plain
    rest = replace(data, values=data.values - predicted.tests)
    left, other = functions(rest, grid, DRAWS, generator)
    share = 1.0 / (1.0 + np.exp(np.clip(evidence - other, -50.0, 50.0)))
    count = round(DRAWS * min(float(share), MOST_PREDICTED))
    # Functions with one size and length scale are neighbours, so a random order takes from all of them.
    picked = generator.permutation(DRAWS)
    return np.concatenate([predicted.grid + left[picked[:count]], plain[picked[count:]]])


def _band(sampled: FloatArray, positive: bool = False) -> Band:
    """Return the band around the mean that contains 95 % of the functions at all places."""
    mean, deviation = sampled.mean(axis=0), sampled.std(axis=0)
    width = np.quantile((np.abs(sampled - mean) / np.maximum(deviation, 1e-300)).max(axis=1), 1.0 - LEVEL)
    lower = mean - width * deviation
    return Band(mean, np.maximum(lower, 0.0) if positive else lower, mean + width * deviation)


def _mode(space: Space, places: FloatArray) -> FloatArray:
    """Return the place with the highest density, from a triangular kernel over a tenth of every axis."""
    distinct, counts = np.unique(in_cube(space, places), axis=0, return_counts=True)
    near = np.clip(1.0 - 10.0 * np.abs(distinct[:, None] - distinct), 0.0, None).prod(axis=2) @ counts
    return space.at(distinct[near.argmax()])


def _notes(space: Space, tests: tuple[RolloutsAtTest, ...]) -> tuple[str, ...]:
    notes = []
    replicated = sum(test.real.size >= 3 for test in tests)
    if 3 * replicated < len(tests):
        notes.append(
            f"{replicated} of {len(tests)} tests have three or more real rollouts; repeat a third of the tests to "
            f"separate noise from the shape of the gap"
        )
    if len(tests) < 2 * space.dim + 1:
        notes.append(
            f"the gap was measured at {len(tests)} test{'s' * (len(tests) != 1)} of a space with {space.dim} "
            f"parameter{'s' * (space.dim != 1)}; elsewhere it is a guess"
        )
    return tuple(notes)
