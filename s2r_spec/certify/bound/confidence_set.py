"""The functions that the outcomes leave possible, as bounds of J over the box.

One event of probability 1 − δ gives bounds for several norm bounds at once: B, 2B, 4B and 8B, the *ladder*.
Everything inside is in units of R.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.bound import confidence
from s2r_spec.certify.bound.bounds import Bounds
from s2r_spec.certify.bound.certificate import Rung
from s2r_spec.certify.bound.modes import MODES
from s2r_spec.certify.bound.posterior import ENGINES, Conditioned
from s2r_spec.certify.bound.samples import Outcomes, OutcomeSamples
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.bound.tiling import Tiling

LADDER = (1.0, 2.0, 4.0, 8.0)
"""Definition: norm bounds as multiples of the declared B, which is the first."""
TOLERANCE = 0.05
"""Tolerance: a cell is split while it hides more than this share of the interval that is left."""
FIRST_SHARE = 0.5
"""Tolerance: the first division of the box hides at most this share of ε, if that is possible with few points."""


class ConfidenceSet:
    """Bounds of J from the declaration and all outcomes so far.

    Attributes:
        norms: (rungs,) norm bounds of the ladder, in units of R.
        bounds: running bounds at points and in cells, in units of R.
        norm_free_worst: (dim,) tested point with the largest lower bound that holds for every B and every kernel.
    """

    def __init__(self, settings: SearchSettings) -> None:
        self._settings = settings
        self.norms: FloatArray = np.array(LADDER) * settings.B / settings.R
        self._mode = MODES[settings.mode](settings.kernel, self.norms)
        self._engine = ENGINES[settings.engine](settings.kernel)
        self._tiling = Tiling(settings.space, settings.kernel, FIRST_SHARE * settings.epsilon / settings.B)
        self.bounds = Bounds(self._tiling, self.norms)
        self._bound = self._mode.before(self.norms)
        self._posterior: Conditioned | None = None
        self._least_norm = 0.0
        self._norm_free_best = -np.inf
        self._norm_free_lower, self._norm_free_upper = np.zeros(0), np.zeros(0)
        self.norm_free_worst: FloatArray = self._tiling.points[0]

    @property
    def points(self) -> FloatArray:
        """(P, dim) all points at which bounds are known."""
        return self._tiling.points

    @property
    def mixture(self) -> FloatArray:
        """(J,) prior scales of the mixture, in units of R²."""
        return self._mode.mixture

    def update(self, outcomes: Outcomes) -> None:
        """Tighten all bounds with the outcomes so far, at u ≥ 1 points."""
        samples = outcomes.samples
        self._posterior = self._engine.condition(self.points, samples)
        self._bound = self._mode.bound(self._posterior, outcomes.rollouts, self.norms, self._settings.delta)
        self.bounds.tighten(self._posterior, self._bound, TOLERANCE)
        points = self.points[samples.at]
        gram = self._settings.kernel.gram(points, points)
        radius = self._bound.radius
        norm = confidence.smallest_norm(gram, samples.counts, samples.means, radius)
        self._least_norm = max(self._least_norm, norm)
        if np.isnan(self._bound.widths[0]).any():  # no function of norm ≤ B fits, by however little
            self._least_norm = max(self._least_norm, float(np.nextafter(self.norms[0], np.inf)) * (1 + 1e-9))
        # The bounds at the tested points that follow from the data-fit set alone.
        best = confidence.norm_free_lower(samples.counts, samples.means, radius)
        self._norm_free_best = max(self._norm_free_best, best)
        margin = np.sqrt(radius / samples.counts)
        new = (0, len(samples) - len(self._norm_free_lower))  # samples keep their order
        lower = np.pad(self._norm_free_lower, new, constant_values=-np.inf)
        upper = np.pad(self._norm_free_upper, new, constant_values=np.inf)
        self._norm_free_lower = np.maximum(lower, samples.means - margin)
        self._norm_free_upper = np.minimum(upper, samples.means + margin)
        self.norm_free_worst = self.points[samples.at[int(self._norm_free_lower.argmax())]]

    def tightest(self, place: int) -> tuple[FloatArray, float, FloatArray]:
        """Return (P,) mean, width and (1,) prior scale of the bound that is lowest at a point."""
        scales, width = self._bound.scales, self._bound.widths[0]
        if self._posterior is None:
            return np.zeros(len(self.points)), float(width[0]), scales
        here = self._posterior.moments(scales, self.points[place : place + 1])
        best = int(np.argmin(here.mean[:, 0] + width * here.std[:, 0]))
        mean = self._posterior.moments(scales[best : best + 1], self.points).mean[0]
        return mean, float(width[best]), scales[best : best + 1]

    def deviation(self, planned: OutcomeSamples, scale: FloatArray) -> FloatArray:
        """Return (P,) posterior standard deviations at a (1,) prior scale, as if the planned samples had been run."""
        posterior = self._engine.condition(self.points, planned)
        return np.asarray(posterior.moments(scale, self.points).std[0])

    # -- in the unit of the outcome ----------------------------------------------------------

    @property
    def smallest_norm(self) -> float:
        """B_low, the smallest RKHS norm of a function that fits the outcomes."""
        return self._least_norm * self._settings.R

    @property
    def norm_free_lower(self) -> float:
        """Lower bound of the maximum that holds for every B and every kernel; −∞ before the first outcome."""
        return self._norm_free_best * self._settings.R

    @property
    def norm_free_empty(self) -> bool:
        """Whether bounds of this kind contradict each other at a tested point: no B explains that, so R is wrong."""
        return bool((self._norm_free_lower > self._norm_free_upper).any())

    @property
    def ladder(self) -> tuple[Rung, ...]:
        """The interval of the maximum under each norm bound, the declared one first."""
        bounds, R = self.bounds, self._settings.R
        rows = zip(self.norms, bounds.best, bounds.maximum, bounds.hidden, strict=True)
        return tuple(Rung(*(float(value) * R for value in row)) for row in rows)

    @property
    def width(self) -> float:
        """Width of the interval under the declared norm bound."""
        R = self._settings.R
        return float(self.bounds.maximum[0]) * R - float(self.bounds.best[0]) * R

    @property
    def range(self) -> tuple[float, float]:
        """Bounds of J anywhere in the box: (lower bound of its minimum, upper bound of its maximum)."""
        R = self._settings.R
        return float(self.bounds.minimum[0]) * R, float(self.bounds.maximum[0]) * R

    def band(self, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return (n,) lower and upper bounds of J at (n, dim) points of the box.

        Raises:
            UsageError: a point is outside the box, or has another dimension.
        """
        space = self._settings.space
        where = np.atleast_2d(np.asarray(points, dtype=np.float64))
        if where.shape[1] != space.dim or not ((where >= space.lower) & (where <= space.upper)).all():
            raise UsageError(
                f"the band is known only at points of shape (n, {space.dim}) within the test space"
            )
        lower, upper = self.bounds.at(where, self._posterior, self._bound)
        return lower[0] * self._settings.R, upper[0] * self._settings.R
