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
from functools import cached_property

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
from s2r_spec.diagnose.simulator.library import Curve, Response

FloatArray = NDArray[np.float64]

SMALL = 0.5
"""Definition: the form error is a part of the responses up to this size, in typical sizes. Up to twice as much, the
errors of observables that only large effects move count more."""
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
    """Real data of one experiment, and the simulator's responses, in units of their errors u.

    Of m observables n are used: those that the real runs, the nominal runs and all responses have.

    Attributes:
        response: of the simulator to every effect.
        kept: (n,) places of the observables that are used.
        scale: (n,) u.
        observed: (n,) difference of the real and the nominal mean, in units of u.
        variants: (V, n) responses to the variants.
        curves: the response to every parameter, at the points at which the simulator does not fall.
        parts: (quantity, statistic) and places among the n of every group.
        correction: (n,) what the simulator's mean is beyond the sum of responses.
    """

    response: Response
    kept: NDArray[np.int64]
    scale: FloatArray
    observed: FloatArray
    variants: FloatArray
    curves: tuple[Curve, ...]
    parts: tuple[tuple[tuple[str, str], NDArray[np.int64]], ...]
    correction: FloatArray

    @classmethod
    def of(cls, response: Response, vectors: Sequence[FloatArray]) -> Observation:
        """Return the observation of (m,) observables of each real run."""
        mean = np.mean(vectors, axis=0)
        usable = np.isfinite(mean) & np.isfinite(response.nominal) & np.isfinite(response.scatter)
        usable &= np.isfinite(response.variants).all(axis=0)
        # A point at which the simulator falls is left out: it would take the rest of the trace from all parameters.
        curves = []
        for curve in response.curves:
            whole = np.isfinite(curve.values[:, response.bins]).all(axis=1)
            curves.append(Curve(curve.coordinates[whole], curve.values[whole]))
            usable &= np.isfinite(curves[-1].values).all(
                axis=0
            )  # such as the mean of a phase that does not occur
        small = [(c.values[np.abs(c.coordinates) <= SMALL] ** 2).max(axis=0) for c in curves]
        signature = np.sqrt(np.mean(small, axis=0))
        error = np.zeros_like(mean)
        parts, kept, start = [], [], 0
        for group in response.groups:
            places = np.arange(group.start, group.stop)[usable[group.start : group.stop]]
            if not places.size:
                continue
            variants = response.variants[:, places]
            error[places] = unit(response.scatter[places], len(vectors), signature[places], variants)
            if error[places].min() > 1e-9:  # a group that nothing moves says nothing
                parts.append(((group.quantity, group.statistic), np.arange(start, start + places.size)))
                kept.append(places)
                start += places.size
        used = np.concatenate(kept) if kept else np.zeros(0, dtype=np.int64)
        scale = error[used]
        return cls(
            response,
            used,
            scale,
            (mean - response.nominal)[used] / scale,
            response.variants[:, used] / scale,
            tuple(Curve(curve.coordinates, curve.values[:, used] / scale) for curve in curves),
            tuple(parts),
            np.zeros(used.size),
        )

    def corrected(self, correction: FloatArray) -> Observation:
        """Return the observation with (m,) another correction of the simulator's mean."""
        return replace(self, correction=correction[self.kept] / self.scale)

    def residual(self, theta: FloatArray) -> FloatArray:
        """Return (n,) the residual at θ."""
        moved = np.sum([curve.at(float(x)) for curve, x in zip(self.curves, theta, strict=True)], axis=0)
        return np.asarray(self.observed - self.correction - moved)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Return (K + V, n) the slopes of all responses, then the variants."""
        slopes = [curve.slope(float(x)) for curve, x in zip(self.curves, theta, strict=True)]
        return np.vstack([*slopes, self.variants])

    @cached_property
    def _layout(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Begin and size of every group."""
        places = [each for _, each in self.parts]
        return np.array([each[0] for each in places]), np.array([each.size for each in places])

    def loss(self, residual: FloatArray) -> float:
        """Return Σ_g ½ (ν + N_g) log(1 + N_g |r_g|²/(n_g ν))."""
        if not self.parts:
            return 0.0
        starts, count = self._layout
        energy = np.add.reduceat(np.clip(residual, -LARGEST, LARGEST) ** 2, starts) / count
        size = np.minimum(count, EFFECTIVE)
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
        return replace(self, observations=tuple(one.corrected(new) for one, new in pairs))


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
    observations, prior = problem.observations, problem.prior
    effects = prior.low.size
    deviation = np.full(effects, SLAB) if deviation is None else deviation
    theta = search(observations, prior) if start is None else start
    found = [Variances.prior(len(one.parts)) for one in observations]
    total, misfit = (
        Likelihood(np.zeros((effects, effects)), np.zeros(effects)),
        [np.zeros(0)] * len(observations),
    )
    for step in range(STEPS + 1):
        likelihoods, found, misfit = [], list(found), []
        for number, one in enumerate(observations):
            places = [each for _, each in one.parts]
            groups = Groups.of(one.residual(theta), one.jacobian(theta), places)
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
    names = tuple(tuple(name for name, _ in one.parts) for one in observations)
    return Fit(theta, marginal(total, shared_error(theta)), tuple(misfit), names, tuple(found))


def _step(total: Likelihood, theta: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return (K,) the Gauss–Newton step of θ; the variants' amounts start from 0 at every step."""
    effects = theta.size
    precision = np.ones(len(total.score))
    precision[:effects] = 1.0 / deviation**2
    gradient = total.score.copy()
    gradient[:effects] -= theta / deviation**2
    return np.asarray(np.linalg.solve(total.information + np.diag(precision), gradient)[:effects])


def search(observations: Sequence[Observation], prior: SizePrior) -> FloatArray:
    """Return (K,) the first estimate: one parameter at a time moves to a point of the library."""
    theta = np.zeros(prior.low.size)
    points = [_points(observations, k, prior) for k in range(theta.size)]
    residuals = [one.residual(theta) for one in observations]
    losses = [one.loss(r) for one, r in zip(observations, residuals, strict=True)]
    for _ in range(4 * theta.size):
        best, move = sum(losses) - GAIN, None
        for k, candidates in enumerate(points):
            current = [one.curves[k].at(float(theta[k])) for one in observations]
            for point in candidates:
                trial = 0.5 * (point**2 - theta[k] ** 2) / SLAB**2
                for one, r, now in zip(observations, residuals, current, strict=True):
                    trial += one.loss(r + now - one.curves[k].at(point))
                if trial < best:
                    best, move = trial, (k, point)
        if move is None:
            break
        theta[move[0]] = move[1]
        residuals = [one.residual(theta) for one in observations]
        losses = [one.loss(r) for one, r in zip(observations, residuals, strict=True)]
    return theta


def _points(observations: Sequence[Observation], parameter: int, prior: SizePrior) -> list[float]:
    """Return the points of the library, the middle between two of them, and a quarter of the first on either side."""
    found = (
        np.unique(np.concatenate([one.curves[parameter].coordinates for one in observations]))
        if observations
        else np.zeros(1)
    )
    if found.size < 2:
        return []
    middle = (found[1:] + found[:-1]) / 2.0
    first = np.array([found[found > 0].min(initial=np.inf), found[found < 0].max(initial=-np.inf)])
    points = np.unique(np.concatenate([found, middle, 0.25 * first[np.isfinite(first)]]))
    return [float(p) for p in points if prior.low[parameter] - 1e-9 <= p <= prior.high[parameter] + 1e-9]
