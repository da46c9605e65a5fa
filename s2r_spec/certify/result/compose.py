"""A bound on the real machine from two searches: simulation and gap.

Search 1 maximises −ρ̂ over simulated rollouts, search 2 maximises −Δ over paired
ones, Δ = ρ_real − ρ̂. Both bands hold for all tests at once. They may therefore be
added test by test, before the worst test is taken:

    min_d E ρ_real ≥ min_d [LCB_ρ̂(d) + LCB_Δ(d)]      with probability ≥ 1 − δ₀ − δ₁.

It is at most min_d [UCB_ρ̂(d) + UCB_Δ(d)], so a failure can be shown, too.

The paper adds the worst cases of both (Theorem 2: ρ* ≥ ρ̂ᵉ − eᵉ). Its bound is never larger, and the result has
it, too. The paper's probability (1−δ₀)(1−δ₁) needs independent searches; the sum δ₀ + δ₁ does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.tiling import MOST_POINTS, Tiling
from s2r_spec.certify.search.search import Search

TOLERANCE = 0.02
"""Tolerance: a cell is split while it hides more than this share of the larger ε of both searches."""


@dataclass(frozen=True)
class Composition:
    """P(lower ≤ worst expected real robustness ≤ upper) ≥ 1 − delta.

    Attributes:
        lower: min_d [LCB_ρ̂(d) + LCB_Δ(d)] over the whole box.
        upper: the smallest UCB_ρ̂(d) + UCB_Δ(d) at a point.
        delta: δ₀ + δ₁.
        worst: the test of the smallest lower bound.
        discretisation: largest excess over the corners inside a cell, contained in ``lower``.
        paper_lower: ρ̂ᵉ − eᵉ with eᵉ = max_d |E Δ|, bounded from the same band.
        gap: (smallest, largest) possible E Δ anywhere.
    """

    lower: float
    upper: float
    delta: float
    worst: dict[str, float]
    discretisation: float
    paper_lower: float
    gap: tuple[float, float]


def compose(simulated: Search, gap: Search) -> Composition:
    """Add the bounds of a search on −ρ̂ and one on −Δ = ρ̂ − ρ_real.

    Raises:
        UsageError: the two searches are not over the same test space.
    """
    tiling = _tiling(simulated, gap)

    def upper(points: FloatArray) -> FloatArray:
        return np.asarray(simulated.band(points)[1] + gap.band(points)[1])

    # Branch and bound: cells are split while they may exceed every point by more than the tolerance.
    tolerance = _tolerance(simulated, gap)
    values = upper(tiling.points)
    while True:
        cells = values[tiling.corners].max(axis=1) + tiling.error
        excess = cells - values.max()
        split = np.flatnonzero((excess > tolerance) & tiling.splittable())
        if not len(split) or len(tiling.points) >= MOST_POINTS:
            break
        known = len(tiling.points)
        tiling.split(split)
        values = np.concatenate([values, upper(tiling.points[known:])])
    known_points = _with_tests(tiling, simulated, gap)
    low, high = gap.range
    # Maximising −Δ, so that Δ lies in [−high, −low].
    paper = -simulated.range[1] - max(high, -low)
    return Composition(
        # Both hold, and so does the larger one: cells may cost the sum more than its parts.
        lower=max(-float(cells.max()), paper),
        upper=float((-simulated.band(known_points)[0] - gap.band(known_points)[0]).min()),
        delta=min(1.0, simulated.delta + gap.delta),
        worst=simulated.space.point(tiling.points[int(values.argmax())]),
        discretisation=float(max(excess.max(), 0.0)),
        paper_lower=paper,
        gap=(-high, -low),
    )


def judge(composition: Composition) -> Verdict:
    """Return the verdict on the real machine from its combined interval."""
    if composition.lower >= 0:
        return Verdict.HOLDS
    return Verdict.VIOLATED if composition.upper < 0 else Verdict.UNKNOWN


def decides(simulated: Search, gap: Search) -> bool:
    """Return whether the combined interval excludes 0.

    Bounds at a few points come first. They show a violation, and a positive sum at one of them rules out that the
    requirement holds; only without one are the cells needed.
    """
    points = _with_tests(_tiling(simulated, gap), simulated, gap)
    lower, upper = np.add(simulated.band(points), gap.band(points))
    if lower.max() > 0 or upper.max() > 0:
        return bool(lower.max() > 0)
    return judge(compose(simulated, gap)) is not Verdict.UNKNOWN


def _with_tests(tiling: Tiling, simulated: Search, gap: Search) -> FloatArray:
    """Return the points of a tiling and all tests, where the bounds are closest."""
    return np.concatenate([tiling.points, simulated.tested, gap.tested])


def _tiling(simulated: Search, gap: Search) -> Tiling:
    if simulated.space != gap.space:
        raise UsageError("the two searches are over different test spaces: their bounds cannot be added")
    return Tiling(simulated.space, _Sum(simulated, gap), 10 * _tolerance(simulated, gap))


def _tolerance(simulated: Search, gap: Search) -> float:
    return TOLERANCE * max(simulated.epsilon, gap.epsilon)


@dataclass(frozen=True)
class _Sum:
    """Roughness of the sum of two functions, in the unit of the outcomes."""

    first: Search
    second: Search

    def hidden(self, sides: FloatArray) -> FloatArray:
        return sum((s.B * s.kernel.hidden(sides) for s in (self.first, self.second)), np.zeros_like(sides))

    def sides_for(self, error: float, dim: int) -> FloatArray:
        each = [s.kernel.sides_for(error / (2 * s.B), dim) for s in (self.first, self.second)]
        return np.minimum(*each)
