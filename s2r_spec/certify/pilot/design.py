"""The tests of a pilot: a grid over the test space, or points that fill it if a grid would be too coarse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.search.search import Query
from s2r_spec.space import Space

REPLICATES = 4
"""Budget: rollouts at each test; their scatter is the noise."""
USUAL = {1: 15, 2: 25, 3: 27}
"""Budget: tests of a grid by the number of parameters, if the user gives no budget."""
FOR_EACH = 10
"""Budget: tests for each parameter beyond three of them (Loeppky, Sacks and Welch 2009)."""
COARSEST = 3
"""Budget: fewest tests on each axis of a grid: two ends and a middle."""
FEWEST = 5
"""Budget: fewest tests."""


@dataclass(frozen=True)
class PilotDesign:
    """(n, dim) tests, the (dim,) distance of neighbours, and a word for the layout, such as "5 × 5"."""

    points: FloatArray
    spacing: FloatArray
    layout: str

    def queries(self, space: Space) -> list[Query]:
        """Return the tests as queries with :data:`REPLICATES` rollouts each."""
        return [Query(i, space.point(vector), REPLICATES) for i, vector in enumerate(self.points)]


def design(space: Space, budget: int | None) -> PilotDesign:
    """Return the tests of a pilot of at most ``budget`` rollouts; a UsageError if these are too few."""
    tests = USUAL.get(space.dim, FOR_EACH * space.dim) if budget is None else budget // REPLICATES
    if tests < FEWEST:
        raise UsageError(
            f"budget = {budget}; a pilot needs at least {FEWEST * REPLICATES} rollouts: {REPLICATES} at each of "
            f"{FEWEST} tests"
        )
    widths = space.upper - space.lower
    side = int(tests ** (1 / space.dim) + 1e-9)
    if side >= COARSEST:
        points = space.grid((side,) * space.dim)
        layout = "evenly spaced" if space.dim == 1 else " × ".join([str(side)] * space.dim)
        return PilotDesign(points, widths / (side - 1), layout)
    from scipy.stats import qmc

    shares = qmc.Halton(space.dim, scramble=False).random(tests + 1)[1:]  # the first point is a corner
    return PilotDesign(space.at(np.asarray(shares)), widths / tests ** (1 / space.dim), "space-filling")
