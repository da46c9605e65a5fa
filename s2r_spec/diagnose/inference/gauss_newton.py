"""Joint estimate of all effects: a search over the points of the library, then Gauss–Newton steps.

Data: y_p (m_p,), the mean observables of real runs of each experiment p. Unknown: θ (K,) in typical sizes. Model and
likelihood: :mod:`.hierarchical`. Prior in the fit: θ_k ~ N(0, σ_slab²) within its range, for every parameter.

The likelihood has several modes, because the variance of a group grows with its residual. So the first estimate is
a search: from θ = 0, one parameter at a time moves to the point of the library that lowers

    Σ_g ½ (ν + N_g) log(1 + N_g |r_g|²/(n_g ν)) + ½ |θ|²/σ_slab²      (Student's t for each group)

the most, until none lowers it by more than :data:`GAIN`. Gauss–Newton goes on from there, with the variances of all
groups at their mode at every step.

The mean of the simulator at θ is the sum of the library's responses and a correction. The correction comes from runs
at the estimate itself (:meth:`Problem.corrected`): it holds the interactions of effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.inference.hierarchical import (
    DEGREES,
    EFFECTIVE,
    LARGEST,
    Groups,
    Likelihood,
    Variances,
    likelihood,
    marginal,
    shared_error,
    unit,
    variances,
)
from s2r_spec.diagnose.inference.prior import SLAB, SizePrior
from s2r_spec.diagnose.simulator.library import Response

FloatArray = NDArray[np.float64]

GAIN = 2.0
"""Tolerance: least gain of a step of the search, in log-likelihood; the odds of one step change by a factor of 7."""
STEPS = 12
"""Budget: most Gauss–Newton steps of a fit."""
CLOSE = 0.002
"""Tolerance: the fit ends when no parameter moves further, in typical sizes."""
FIRST = 0.7
"""Tolerance: part of the first two steps that is taken, since the variances still move."""


@dataclass(frozen=True)
class Observation:
    """Real data of one experiment.

    Attributes:
        response: of the simulator to every effect.
        mean: (m,) mean observables of the real runs; NaN where nothing was recorded.
        runs: number of them.
        correction: (m,) what the simulator's mean is beyond the sum of responses.
    """

    response: Response
    mean: FloatArray
    runs: int
    correction: FloatArray

    @classmethod
    def of(cls, response: Response, vectors: Sequence[FloatArray]) -> Observation:
        """Return the observation of (m,) observables of each real run."""
        return cls(response, np.mean(vectors, axis=0), len(vectors), np.zeros_like(response.nominal))


class _Prepared:
    """An observation in units of its errors: what a fit needs again and again."""

    def __init__(self, observation: Observation) -> None:
        r = observation.response
        usable = np.isfinite(observation.mean) & np.isfinite(r.nominal) & np.isfinite(r.scatter)
        usable &= np.isfinite(r.variants).all(axis=0)
        # A point at which the simulator falls is left out: it would take the rest of the trace from all parameters.
        whole = [np.isfinite(v[:, r.bins]).all(axis=1) for v in r.values]
        self.coordinates = [c[kept] for c, kept in zip(r.coordinates, whole, strict=True)]
        values = [v[kept] for v, kept in zip(r.values, whole, strict=True)]
        for each in values:
            usable &= np.isfinite(each).all(axis=0)  # such as the mean of a phase that does not occur
        small = [v[np.abs(c) <= 0.5] for c, v in zip(self.coordinates, values, strict=True)]
        signature = np.sqrt(np.mean([(v**2).max(axis=0) for v in small], axis=0))
        shape = np.ones_like(r.nominal)
        parts, names = [], []
        for group in r.groups:
            part = np.arange(group.start, group.stop)[usable[group.start : group.stop]]
            if not part.size:
                continue
            shape[part] = unit(r.scatter[part], observation.runs, signature[part], r.variants[:, part])
            if shape[part].min() > 1e-9:  # a group that nothing moves says nothing
                parts.append(part)
                names.append((group.quantity, group.statistic))
        self.names = tuple(names)
        kept = np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
        sizes = np.array([part.size for part in parts], dtype=np.int64)
        self.starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        self.parts = [np.arange(start, start + size) for start, size in zip(self.starts, sizes, strict=True)]
        self.sizes = sizes
        scale = shape[kept]
        self.observed = (observation.mean - observation.correction - r.nominal)[kept] / scale
        self.variants = r.variants[:, kept] / scale
        self.values = [v[:, kept] / scale for v in values]

    def at(self, parameter: int, coordinate: float) -> FloatArray:
        """Return the response to a parameter."""
        c, v = self.coordinates[parameter], self.values[parameter]
        if len(c) < 2:
            return np.zeros_like(self.observed)
        place = self._place(c, coordinate)
        return np.asarray(
            v[place] + (v[place + 1] - v[place]) * (coordinate - c[place]) / (c[place + 1] - c[place])
        )

    def residual(self, theta: FloatArray) -> FloatArray:
        """Return the residual at θ."""
        return np.asarray(
            self.observed - np.sum([self.at(k, float(theta[k])) for k in range(len(theta))], axis=0)
        )

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Return (K + V, m) the slopes of all responses, then the variants."""
        rows = []
        for k, (c, v) in enumerate(zip(self.coordinates, self.values, strict=True)):
            if len(c) < 2:
                rows.append(np.zeros_like(self.observed))
                continue
            place = self._place(c, float(theta[k]))
            rows.append((v[place + 1] - v[place]) / (c[place + 1] - c[place]))
        return np.vstack([*rows, self.variants])

    @staticmethod
    def _place(c: FloatArray, coordinate: float) -> int:
        return min(max(int(np.searchsorted(c, coordinate, side="right")) - 1, 0), len(c) - 2)

    def loss(self, residual: FloatArray) -> float:
        """Return Σ_g ½ (ν + N_g) log(1 + N_g |r_g|²/(n_g ν))."""
        if not self.sizes.size:
            return 0.0
        energy = np.add.reduceat(np.clip(residual, -LARGEST, LARGEST) ** 2, self.starts) / self.sizes
        size = np.minimum(self.sizes, EFFECTIVE)
        return float(0.5 * np.sum((DEGREES + size) * np.log1p(size * energy / DEGREES)))


@dataclass(frozen=True)
class Problem:
    """What is to be estimated from what.

    Attributes:
        observations: one for each experiment.
        prior: of the sizes.
    """

    observations: tuple[Observation, ...]
    prior: SizePrior

    def corrected(self, corrections: Sequence[FloatArray]) -> Problem:
        """Return the problem with (m_p,) another correction of every experiment."""
        pairs = zip(self.observations, corrections, strict=True)
        return replace(self, observations=tuple(replace(one, correction=new) for one, new in pairs))


@dataclass(frozen=True)
class Fit:
    """The joint estimate.

    Attributes:
        theta: (K,) estimate of every parameter.
        likelihood: of θ around the estimate, with the shared error; the prior is not in it.
        misfit: of every experiment, (G,) energy of each group that the fit leaves, in units of u².
        groups: of every experiment, (quantity, statistic) of each group.
        variances: of every experiment.
    """

    theta: FloatArray
    likelihood: Likelihood
    misfit: tuple[FloatArray, ...]
    groups: tuple[tuple[tuple[str, str], ...], ...]
    variances: tuple[Variances, ...]


def fit(problem: Problem, start: FloatArray | None = None, deviation: FloatArray | None = None) -> Fit:
    """Return the joint estimate.

    Args:
        problem: data and prior.
        start: (K,) first estimate; the search finds one without it.
        deviation: (K,) prior standard deviation of every size in the fit; without it, that of a cause.
    """
    prepared = [_Prepared(one) for one in problem.observations]
    prior = problem.prior
    effects = prior.low.size
    deviation = np.full(effects, SLAB) if deviation is None else deviation
    theta = search(prepared, prior) if start is None else start
    found = [Variances.prior(len(one.parts)) for one in prepared]
    total, misfit = Likelihood(np.zeros((effects, effects)), np.zeros(effects)), [np.zeros(0)] * len(prepared)
    for step in range(STEPS + 1):
        likelihoods, found, misfit = [], list(found), []
        for number, one in enumerate(prepared):
            groups = Groups.of(one.residual(theta), one.jacobian(theta), one.parts)
            found[number] = variances(groups, theta, found[number], 2 if step == 0 else 1)
            likelihoods.append(likelihood(groups, theta, found[number]))
            misfit.append(groups.energy)
        total = sum(likelihoods[1:], likelihoods[0])
        if step == STEPS:
            break
        moved = _step(total, theta, deviation) * (FIRST if step < 2 else 1.0)
        new = np.clip(theta + moved, prior.low, prior.high)
        if np.abs(new - theta).max(initial=0.0) < CLOSE:
            break
        theta = new
    names = tuple(one.names for one in prepared)
    return Fit(theta, marginal(total, shared_error(theta)), tuple(misfit), names, tuple(found))


def _step(total: Likelihood, theta: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return (K,) the Gauss–Newton step of θ; the variants' amounts start from 0 at every step."""
    effects = theta.size
    precision = np.ones(len(total.score))
    precision[:effects] = 1.0 / deviation**2
    gradient = total.score.copy()
    gradient[:effects] -= theta / deviation**2
    return np.asarray(np.linalg.solve(total.information + np.diag(precision), gradient)[:effects])


def search(prepared: Sequence[_Prepared], prior: SizePrior) -> FloatArray:
    """Return (K,) the first estimate: one parameter at a time moves to a point of the library."""
    theta = np.zeros(prior.low.size)
    points = [_points(prepared, k, prior) for k in range(theta.size)]
    residuals = [one.residual(theta) for one in prepared]
    losses = [one.loss(r) for one, r in zip(prepared, residuals, strict=True)]
    for _ in range(4 * theta.size):
        best, move = sum(losses) - GAIN, None
        for k, candidates in enumerate(points):
            current = [one.at(k, theta[k]) for one in prepared]
            for point in candidates:
                trial = 0.5 * (point**2 - theta[k] ** 2) / SLAB**2
                for one, r, now in zip(prepared, residuals, current, strict=True):
                    trial += one.loss(r + now - one.at(k, point))
                if trial < best:
                    best, move = trial, (k, point)
        if move is None:
            break
        theta[move[0]] = move[1]
        residuals = [one.residual(theta) for one in prepared]
        losses = [one.loss(r) for one, r in zip(prepared, residuals, strict=True)]
    return theta


def _points(prepared: Sequence[_Prepared], parameter: int, prior: SizePrior) -> list[float]:
    """Return the points of the library, the middle between two of them, and a quarter of the first on either side."""
    found = (
        np.unique(np.concatenate([one.coordinates[parameter] for one in prepared]))
        if prepared
        else np.zeros(1)
    )
    if found.size < 2:
        return []
    middle = (found[1:] + found[:-1]) / 2.0
    first = np.array([found[found > 0].min(initial=np.inf), found[found < 0].max(initial=-np.inf)])
    points = np.unique(np.concatenate([found, middle, 0.25 * first[np.isfinite(first)]]))
    return [float(p) for p in points if prior.low[parameter] - 1e-9 <= p <= prior.high[parameter] + 1e-9]
