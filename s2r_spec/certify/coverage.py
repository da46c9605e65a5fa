"""Tests inside the box, along axes on which a kernel is longer than the box.

A function of norm ≤ B changes by at most B · s · w/ℓ along an axis of range w and lengthscale ℓ (s: the
kernel's slope). The longer ℓ, the less a search learns by testing inside the range, and with ℓ a thousand
times the range it tests the corners only: whatever is true inside, no outcome could then contradict the
declared kernel. So two rules hold on an axis with ℓ > w, and none on any other:

- If the declared kernel and B leave E no more than ε to change by, the certificate would rest on the
  declaration and on no test: it is refused (:func:`constant`).
- Else each eighth of the range is tested before a certificate is given (:class:`Coverage`), with as many rollouts
  as tell 0 from ε there. The tests are drawn from the seed, never from outcomes, so that the bound asks no
  more of them; and what they find may refute B like any other outcome.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.certify.bounds import MOST_POINTS
from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.rounding import at_most
from s2r_spec.certify.sample_complexity import sequential_lower_bound
from s2r_spec.space import ROUNDED, Space

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

LEVELS = 8
"""Parts of an axis' range that are each tested (budget). With twice as many a certificate takes up to twice the
rollouts, and dips of half the width are seen."""
LEAST = 2
"""Rollouts of a test, for scatter between replicates is all that can refute R (definition)."""
MOST_ROLLOUTS = 1e12
"""Rollouts beyond which a search without a budget is not begun (definition of what nobody can run)."""


def long_axes(space: Space, kernel: Kernel) -> tuple[int, ...]:
    """Return the axes whose range is shorter than their lengthscale."""
    longer = kernel.lengthscales(space.dim) > (space.upper - space.lower) * (1 + ROUNDED)
    return tuple(np.flatnonzero(longer).tolist())


def constant(space: Space, kernel: Kernel, B: float, epsilon: float) -> str:
    """Return a sentence if the declared kernel and B say that a parameter changes nothing by ε, else ""."""
    change = B * kernel.change(space.upper - space.lower)
    for axis in long_axes(space, kernel):
        if change[axis] <= epsilon:
            name, unit = space.axes[axis].name, space.axes[axis].unit
            length = kernel.lengthscales(space.dim)[axis]
            times = at_most(length / space.axes[axis].width)
            return (
                f"the lengthscale of {name} is {length:g} {unit}".rstrip()
                + f", {times} times its range: with B = {B:g} no test of {name} could change the outcome by more than "
                f"{at_most(change[axis])}, and epsilon is {epsilon:g}; check the unit of the lengthscale"
            )
    return ""


def tests_apart(space: Space, kernel: Kernel) -> float:
    """Return how many tests a box holds that are one lengthscale apart: about what no certificate can do without."""
    cells = np.maximum(1.0, (space.upper - space.lower) / kernel.lengthscales(space.dim))
    return float(10 ** min(300.0, np.log10(cells).sum()))


def log_rollouts(tests: float, spread: int, batch: float) -> float:
    """Return log10 of the rollouts by which a search has come to so many tests.

    A batch holds ``spread`` tests and 2 · spread rollouts, or the share ``batch`` of all so far if that is more.
    """
    batches = max(1.0, tests / spread)
    even = min(batches, 1 / batch)
    return math.log10(2 * spread * even) + (batches - even) * math.log10(1 + batch)


def too_many(space: Space, kernel: Kernel, spread: int, batch: float, budget: int | None) -> str:
    """Return a sentence if a certificate would take more tests, or rollouts, than there can be, else ""."""
    tests = tests_apart(space, kernel)
    if tests > MOST_POINTS:
        limit = f"s2r holds {MOST_POINTS:,}"
    elif budget is None and log_rollouts(tests, spread, batch) > math.log10(MOST_ROLLOUTS):
        limit = f"that would take more than {MOST_ROLLOUTS:.0e} rollouts"
    else:
        return ""
    cells = (space.upper - space.lower) / kernel.lengthscales(space.dim)
    axis = space.axes[int(cells.argmax())]
    length = kernel.lengthscales(space.dim)[cells.argmax()]
    about = f"{float(f'{tests:.1g}'):,.0f}" if tests < 1e12 else f"{tests:.0e}"
    return (
        f"the lengthscale of {axis.name} is {length:g} {axis.unit}".rstrip()
        + f", and its range {cells.max():.3g} times that: about {about} tests are needed, one lengthscale apart, "
        f"and {limit}; check the unit of the lengthscale"
    )


@dataclass(frozen=True)
class Coverage:
    """Which eighths of the long axes were tested.

    Attributes:
        space: the test space.
        axes: (L,) indices of its long axes; with none of them nothing is ever lacking.
    """

    space: Space
    axes: tuple[int, ...]

    @property
    def covering(self) -> int:
        """Fewest rollouts in each part: a replicated test for every parameter, so that tests fill the box."""
        return LEAST * self.space.dim

    def telling(self, R: float, width: float, delta: float) -> int:
        """Return the rollouts in each part without which 0 cannot be distinguished from ``width`` there."""
        return max(self.covering, math.ceil(min(sequential_lower_bound(R, width, delta), MOST_ROLLOUTS)))

    def lacking(self, points: FloatArray, counts: FloatArray, least: int) -> IndexArray:
        """Return (L, LEVELS) rollouts that each part lacks of ``least``, after (u,) counts at (u, dim) points."""
        return np.maximum(0, least - self._done(points, counts))

    def batch(
        self, points: FloatArray, counts: FloatArray, least: int, rng: np.random.Generator
    ) -> list[tuple[FloatArray, int]]:
        """Return (point, replicates) of the next tests, at most as many rollouts in a part as it has had.

        A Latin hypercube: on every axis the tests are in different parts, as far as there are parts.
        """
        done = self._done(points, counts)
        wanted = np.minimum(np.maximum(0, least - done), np.maximum(LEAST, done))
        number = int((wanted > 0).sum(axis=1).max(initial=0))
        parts = np.stack([rng.permutation(LEVELS)[:number] for _ in self.space.axes], axis=1)
        replicates = np.zeros(number, dtype=np.intp)
        for row, axis in enumerate(self.axes):
            short = rng.permutation(np.flatnonzero(wanted[row]))
            parts[: len(short), axis] = short
            replicates[: len(short)] = np.maximum(replicates[: len(short)], wanted[row, short])
        share = (parts + rng.uniform(size=parts.shape)) / LEVELS
        return [
            (self.space.at(place), max(LEAST, int(count)))
            for place, count in zip(share, replicates, strict=True)
        ]

    def _done(self, points: FloatArray, counts: FloatArray) -> IndexArray:
        """Return (L, LEVELS) rollouts in each part."""
        share = (points - self.space.lower) / (self.space.upper - self.space.lower)
        part = np.clip((share * LEVELS).astype(np.intp), 0, LEVELS - 1)
        done = [np.bincount(part[:, axis], counts, minlength=LEVELS) for axis in self.axes]
        return np.array(done, dtype=np.intp).reshape(len(self.axes), LEVELS)
