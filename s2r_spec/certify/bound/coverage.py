"""Tests inside the box, along axes on which the kernel's lengthscale is longer than the range.

A function of norm ≤ B changes by at most B · s · w/ℓ along an axis of range w and lengthscale ℓ (s: the
kernel's slope). The longer ℓ is, the less a search learns inside the range. With ℓ a thousand times the range
it tests only the corners, and no outcome could then contradict the declared kernel, whatever happens inside.
So two rules hold on an axis with ℓ > w, and none on any other:

- If the declared kernel and B leave J no more than ε to change by, the certificate would rest on the
  declaration, not on tests. It is refused (:mod:`s2r_spec.certify.search.feasibility`).
- Else each eighth of the range is tested before a certificate is given, with as many rollouts as distinguish 0
  from ε there (:class:`Coverage`). The tests depend on the seed, not on an outcome, so the bound holds as it
  is. Their outcomes may refute B like any others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.sample_complexity import sequential_lower_bound
from s2r_spec.space import ROUNDED, Space

IndexArray = NDArray[np.intp]

PARTS = 8
"""Budget: parts of an axis' range that are each tested."""
LEAST = 2
"""Definition: rollouts of a test, for only scatter between replicates can refute R."""
MOST_ROLLOUTS = 1e12
"""Definition: rollouts that nobody can run. A search without a budget that takes more is not begun."""


def long_axes(space: Space, kernel: Kernel) -> tuple[int, ...]:
    """Return the axes whose range is shorter than their lengthscale."""
    longer = kernel.lengthscales(space.dim) > (space.upper - space.lower) * (1 + ROUNDED)
    return tuple(np.flatnonzero(longer).tolist())


@dataclass(frozen=True)
class Coverage:
    """Tests in every eighth of the long axes.

    Attributes:
        space: the test space.
        axes: (L,) indices of its long axes; without any, no test is ever lacking.
    """

    space: Space
    axes: tuple[int, ...]

    @property
    def names(self) -> str:
        """The long axes by name."""
        return ", ".join(self.space.axes[axis].name for axis in self.axes)

    @property
    def least(self) -> int:
        """Fewest rollouts in each part: a replicated test for every parameter, so that tests fill the box."""
        return LEAST * self.space.dim

    def needed(self, R: float, width: float, delta: float) -> int:
        """Return the rollouts that each part takes to distinguish an outcome of 0 from ``width``."""
        return max(self.least, math.ceil(min(sequential_lower_bound(R, width, delta), MOST_ROLLOUTS)))

    def design(
        self, points: FloatArray, counts: FloatArray, needed: int, rng: np.random.Generator
    ) -> list[tuple[FloatArray, int]]:
        """Return (point, replicates) of the next tests, a Latin hypercube.

        On every axis the tests lie in different parts until all parts are used. A part gets no more rollouts than it
        already has.

        Args:
            points: (u, dim) tested points.
            counts: (u,) their rollouts.
            needed: rollouts that each part must have.
            rng: the generator of the places.
        """
        done = self._done(points, counts)
        additional = np.minimum(np.maximum(0, needed - done), np.maximum(LEAST, done))
        number = int((additional > 0).sum(axis=1).max(initial=0))
        parts = np.stack([rng.permutation(PARTS)[:number] for _ in self.space.axes], axis=1)
        replicates = np.zeros(number, dtype=np.intp)
        for row, axis in enumerate(self.axes):
            short = rng.permutation(np.flatnonzero(additional[row]))
            parts[: len(short), axis] = short
            replicates[: len(short)] = np.maximum(replicates[: len(short)], additional[row, short])
        share = (parts + rng.uniform(size=parts.shape)) / PARTS
        return [
            (self.space.at(place), max(LEAST, int(count)))
            for place, count in zip(share, replicates, strict=True)
        ]

    def uncovered(self, points: FloatArray, counts: FloatArray) -> str:
        """Return a sentence on the first part with too few rollouts, "" if there is none.

        For ``points`` and ``counts`` see :meth:`design`.
        """
        lacking = np.maximum(0, self.least - self._done(points, counts))
        rows, parts = np.nonzero(lacking)
        if not len(rows):
            return ""
        axis = self.space.axes[self.axes[rows[0]]]
        low, high = (axis.low + axis.width * (parts[0] + end) / PARTS for end in (0, 1))
        return (
            f"the lengthscale is longer than the range of {axis.name}, so every eighth of the range must be tested "
            f"first; {axis.name} in [{low:.4g}, {high:.4g}] {axis.unit}".rstrip()
            + f" lacks {lacking[rows[0], parts[0]]} of {self.least} rollouts"
        )

    def _done(self, points: FloatArray, counts: FloatArray) -> IndexArray:
        """Return the rollouts in each of the (L, PARTS) parts."""
        share = (points - self.space.lower) / (self.space.upper - self.space.lower)
        part = np.clip((share * PARTS).astype(np.intp), 0, PARTS - 1)
        done = [np.bincount(part[:, axis], counts, minlength=PARTS) for axis in self.axes]
        return np.array(done, dtype=np.intp).reshape(len(self.axes), PARTS)
