"""Joint estimate of all effects: a search over the points of the library, then Gauss–Newton steps.

Data: y_p (m_p,), the mean observables of real runs of each experiment p. Unknown: θ (K,) in typical sizes. Model and
likelihood: :mod:`.hierarchical`. Prior in the fit: θ_k ~ N(0, σ_slab²) within its range. Around a mode it is
N(0, σ_bg²) for parameters that are not its causes.

The error of an observable i of group g has the shape

    u_i² = scatter² + variants² + background² + Σ_k [(ρ F_k,i)² + (κ_g ΔF_k,i)² + bend_k,i² + θ_k² spread_k,i²]

F_k is the response to parameter k, of which another author's law differs by a part ρ. ΔF_k is its change since the last
runs of the simulator, and κ_g the relative error of a sum of responses (:mod:`.additivity`). *bend* is the error of
interpolation, and *spread* the scatter of a response from run to run. So a group that an effect throws into
disorder says little about this effect. *background* is the error of sum and scatter at σ_bg of every parameter. Half of
the sum and of the background is spread evenly over the group.

Since u depends on θ, it is fixed within a Gauss–Newton step (a quasi-likelihood; McCullagh & Nelder, *Generalized
Linear Models*, ch. 9). Two first estimates are compared under the larger of their u, and modes under its posterior
mean.

The first estimate is a search: from θ = 0, one parameter at a time, with its dependents, moves to the point of the
library that lowers

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

from s2r_spec.diagnose.inference.additivity import relative_errors
from s2r_spec.diagnose.inference.hierarchical import (
    DEGREES,
    LARGEST,
    LAW_SHARE,
    ROUNDS,
    Groups,
    Likelihood,
    Variances,
    disagreement,
    form_error,
    information_by_group,
    information_left,
    likelihood,
    shared_error,
    variances,
    with_form_error,
    with_shared_error,
    without_variants,
)
from s2r_spec.diagnose.inference.prior import BACKGROUND, SLAB, SizePrior
from s2r_spec.diagnose.simulator.curve import ResponseCurve
from s2r_spec.diagnose.simulator.response import Dependence, Response, replicates
from s2r_spec.trace.trace import FloatArray

GAIN = 2.0
"""Tolerance: least gain of a step of the search, in log-likelihood; the odds of one step change by a factor of 7."""
TRIED = 40
"""Budget: moves of the search that are tried before all others."""
STEPS = 12
"""Budget: most Gauss–Newton steps of a fit."""
CLOSE = 0.002
"""Tolerance: the fit ends when no parameter moves further, in typical sizes."""
FIRST = 0.7
"""Tolerance: part of the first two steps that is taken, since the variances still move."""


@dataclass(frozen=True)
class Observation:
    """Real data of one experiment, and the simulator's responses.

    Of m observables n are used: those that the real runs, the nominal runs and all responses have.

    Attributes:
        response: of the simulator to every effect.
        dependence: which responses are in proportion to another parameter.
        kept: (n,) places of the observables that are used.
        parts: (quantity, statistic) and places among the n of every group.
        observed: (n,) difference of the real and the nominal mean.
        noise: (n,) variance of this difference by the scatter of the runs and by the variants.
        curves: the response to every parameter, at the points at which the simulator does not fall.
        spread: (K, n) variance of the difference by the scatter of the responses, for a coordinate of 1.
        variants: (V, n) responses to the variants.
        coherent: (G,) ρ_g.
        effective: (G,) N_g.
        form: (n,) κ_g of the group of every observable.
        correction: (n,) what the simulator's mean is beyond the sum of responses, from runs at ``ran``.
        ran: (K,) coordinates at which the simulator ran; 0 before any correction.
        exact: (n,) whether that run has the observable; one that ended early lacks the rest.
        law: ρ, the part by which another author's law differs.
    """

    response: Response
    dependence: Dependence
    kept: NDArray[np.int64]
    parts: tuple[tuple[tuple[str, str], NDArray[np.int64]], ...]
    observed: FloatArray
    noise: FloatArray
    curves: tuple[ResponseCurve, ...]
    spread: FloatArray
    variants: FloatArray
    coherent: FloatArray
    effective: FloatArray
    form: FloatArray
    correction: FloatArray
    ran: FloatArray
    exact: NDArray[np.bool_]
    law: float = LAW_SHARE

    @classmethod
    def of(cls, response: Response, vectors: Sequence[FloatArray], dependence: Dependence) -> Observation:
        """Return the observation of (m,) observables of each real run. Runs that ended early count if no other did."""
        whole = [each for each in vectors if np.isfinite(each[response.bins]).all()] or vectors
        mean = np.mean(whole, axis=0)
        usable = np.isfinite(mean) & np.isfinite(response.nominal) & np.isfinite(response.scatter)
        usable &= np.isfinite(response.variants).all(axis=0)
        # A point at which the simulator falls is left out: it would take the rest of the trace from all parameters.
        curves = []
        for curve in response.curves:
            stood = np.isfinite(curve.values[:, response.bins]).all(axis=1)
            curves.append(replace(curve, coordinates=curve.coordinates[stood], values=curve.values[stood]))
            # Some points lack an observable, such as the mean of a phase that does not occur.
            usable &= np.isfinite(curves[-1].values).all(axis=0)
        moved = np.max([np.abs(curve.values).max(axis=0) for curve in curves], axis=0) > 1e-9
        parts, kept, start = [], [], 0
        repeats = _repeats(response, moved & usable)
        for group in response.groups_of(np.isfinite(mean)):
            if group.quantity in repeats:
                continue
            places = np.arange(group.start, group.stop)[usable[group.start : group.stop]]
            if places.size and moved[places].any():  # a group that nothing moves says nothing
                parts.append(((group.quantity, group.statistic), np.arange(start, start + places.size)))
                kept.append(places)
                start += places.size
        used = np.concatenate(kept) if kept else np.zeros(0, dtype=np.int64)
        bare = cls(
            response,
            dependence,
            used,
            tuple(parts),
            (mean - response.nominal)[used],
            np.zeros(used.size),
            tuple(replace(curve, values=curve.values[:, used]) for curve in curves),
            np.zeros((len(curves), used.size)),
            response.variants[:, used],
            np.full(len(parts), LAW_SHARE),
            np.array([float(places.size) for _, places in parts]),
            np.full(used.size, LAW_SHARE),
            np.zeros(used.size),
            np.zeros(len(curves)),
            np.ones(used.size, dtype=bool),
        )
        observation = bare.of_runs(len(whole))
        return observation._calibrated() if parts else observation

    def of_runs(self, runs: int) -> Observation:
        """Return the observation with the scatter of the mean of so many real runs."""
        response, used = self.response, self.kept
        noise = response.scatter[used] ** 2 / runs + (self.variants**2).sum(axis=0)
        spread = response.spread[:, used] * (1.0 / runs + 1.0 / replicates(response.experiment))
        return replace(self, noise=noise, spread=spread)

    def corrected(self, correction: FloatArray, theta: FloatArray) -> Observation:
        """Return the observation with (m,) another correction of the simulator's mean, from runs at θ.

        It is NaN where a run has no value; there the sum of responses counts.
        """
        exact = np.isfinite(correction[self.kept])
        new = np.where(exact, correction[self.kept], 0.0)
        return replace(self, correction=new, ran=theta, exact=exact)

    def moved(self, theta: FloatArray) -> FloatArray:
        """Return (n,) the sum of the responses at θ."""
        factors = self.dependence.factors(theta)
        each = [f * c.at(float(x)) for f, c, x in zip(factors, self.curves, theta, strict=True)]
        return np.asarray(np.sum(each, axis=0))

    def residual(self, theta: FloatArray) -> FloatArray:
        """Return (n,) the residual at θ."""
        return self.observed - self.correction - self.moved(theta)

    def columns(self, theta: FloatArray, secants: bool = False) -> FloatArray:
        """Return (K + V, n) the tangents of all responses at θ, or their secants from nominal, then the variants."""
        factors = self.dependence.factors(theta)
        slopes = [
            f * (c.secant(float(x)) if secants else c.slope(float(x)))
            for f, c, x in zip(factors, self.curves, theta, strict=True)
        ]
        for k, base in self.dependence.pairs:
            slopes[base] = slopes[base] + self.curves[k].at(float(theta[k])) / self.dependence.at[k]
        return np.vstack([*slopes, self.variants])

    def error(self, parameter: int, size: float, deviation: float = 0.0) -> FloatArray:
        """Return (n,) the variance of a response of this size ± deviation.

        Its parts are the law, the sum of responses, the interpolation, and the scatter from run to run. Where the
        simulator ran, the sum and the interpolation have no error.
        """
        curve, (moved, bent) = self.curves[parameter], self._where_ran[parameter]
        bend = curve.bend(size) - bent
        beyond = [(curve.at(each) - moved) ** 2 for each in {size - deviation, size + deviation}]
        law = self.law**2 * curve.at(size) ** 2
        return np.asarray(
            law + self.form**2 * np.mean(beyond, axis=0) + bend**2 + size**2 * self.spread[parameter]
        )

    def errors(self, theta: FloatArray, deviation: FloatArray | None = None) -> FloatArray:
        """Return (n,) the sum of the variances of all responses at θ ± (K,) deviations."""
        factors = self.dependence.factors(theta)
        deviation = np.zeros_like(theta) if deviation is None else deviation
        each = [
            f**2 * self.error(k, x, d)
            for k, (x, d, f) in enumerate(
                zip(theta.tolist(), deviation.tolist(), factors.tolist(), strict=True)
            )
        ]
        return np.asarray(np.sum(each, axis=0))

    def unit(self, errors: FloatArray) -> FloatArray:
        """Return (n,) u from (n,) the variances of responses; half of these is spread evenly over a group."""
        if not self.parts:
            return np.zeros(0)
        errors = errors + self._background
        starts, count = self._layout
        level = np.repeat(np.add.reduceat(errors, starts) / count, count)
        return np.asarray(np.sqrt(self.noise + 0.5 * (errors + level)) + 1e-12)

    def loss(self, residual: FloatArray, unit: FloatArray) -> float:
        """Return Σ_g ½ (ν + N_g) log(1 + N_g |r_g|²/(n_g ν))."""
        if not self.parts:
            return 0.0
        starts, count = self._layout
        energy = np.add.reduceat(np.clip(residual / unit, -LARGEST, LARGEST) ** 2, starts) / count
        size = self.effective
        return float(np.sum(0.5 * (DEGREES + size) * np.log1p(size * energy / DEGREES)))

    def groups(self, theta: FloatArray, errors: FloatArray, secants: bool = False) -> Groups:
        """Return the groups at θ, under the error of (n,) these variances."""
        places = [each for _, each in self.parts]
        columns = self.columns(theta, secants)
        return Groups.of(
            self.residual(theta), columns, self.unit(errors), places, self.coherent, self.effective
        )

    def _calibrated(self) -> Observation:
        """Return the observation with the relative errors that the practice machines show."""
        practice = self.response.practice
        sums = np.array([self.moved(theta) for theta in practice.theta])
        rest = practice.values[:, self.kept] - self.response.nominal[self.kept] - sums
        rest = rest - practice.variant @ self.variants
        runs = self.response.scatter[self.kept] ** 2
        # The error of the sum itself: interpolation and scatter, without form.
        plain = replace(
            self, law=0.0, form=np.zeros_like(self.form), spread=2.0 * self.response.spread[:, self.kept]
        )
        noise = np.sqrt([runs + plain.errors(theta) + self._background + 1e-24 for theta in practice.theta])
        coherent, other, size = relative_errors(sums, rest, noise, [each for _, each in self.parts])
        return replace(self, coherent=coherent, effective=size, form=np.repeat(other, self._layout[1]))

    @cached_property
    def _where_ran(self) -> list[tuple[FloatArray, FloatArray]]:
        """Response (n,) to each parameter where the simulator ran, and its bend; 0 where that run has no value."""
        places = zip(self.curves, self.ran.tolist(), strict=True)
        return [(self.exact * c.at(x), self.exact * c.bend(x)) for c, x in places]

    @cached_property
    def _background(self) -> FloatArray:
        """(n,) variance of the responses to small amounts of every effect."""
        each = [
            np.mean([self.form**2 * c.at(s * BACKGROUND) ** 2 for s in (-1.0, 1.0)], axis=0)
            for c in self.curves
        ]
        return np.asarray(np.sum(each, axis=0) + BACKGROUND**2 * self.spread.sum(axis=0))

    @cached_property
    def _layout(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Begin and size of every group."""
        places = [each for _, each in self.parts]
        return np.array([each[0] for each in places]), np.array([each.size for each in places])


def _repeats(response: Response, moved: NDArray[np.bool_]) -> set[str]:
    """Return the differences of two channels of which no effect moves one: they repeat the other, and say nothing new.

    Such a channel is a reference that is the same in every run of the experiment.
    """
    moving = {g.quantity for g in response.observables.groups if moved[g.start : g.stop].any()}
    return {
        one.name
        for one in response.observables.quantities
        if one.minus and not {one.channel, one.minus} <= moving
    }


@dataclass(frozen=True)
class Problem:
    """What is to be estimated from what.

    Attributes:
        observations: one for each experiment.
        prior: of the sizes.
    """

    observations: tuple[Observation, ...]
    prior: SizePrior

    def corrected(self, corrections: Sequence[FloatArray], theta: FloatArray) -> Problem:
        """Return the problem with (m_p,) another correction of every experiment, from runs at θ."""
        pairs = zip(self.observations, corrections, strict=True)
        return replace(self, observations=tuple(one.corrected(new, theta) for one, new in pairs))

    def with_law(self, law: float) -> Problem:
        """Return the problem with another ρ."""
        return replace(self, observations=tuple(replace(one, law=law) for one in self.observations))

    @property
    def law(self) -> float:
        """The ρ of all experiments."""
        return self.observations[0].law

    @property
    def ran(self) -> FloatArray:
        """(K,) coordinates at which the simulator ran."""
        return self.observations[0].ran

    def errors(self, theta: FloatArray, deviation: FloatArray | None = None) -> list[FloatArray]:
        """Return (n_p,) the variances of all responses at θ ± (K,) deviations, for every experiment."""
        return [one.errors(theta, deviation) for one in self.observations]


@dataclass(frozen=True)
class Errors:
    """Errors of the model in a fit. They grow with the sizes of effects, and are fixed within a fit.

    An estimate that lowered its own error by being small would be drawn to 0.

    Attributes:
        variances: (n_p,) of the responses in u, for every experiment. Fits whose evidence is compared have the same.
        sizes: (K,) at which the law errors are.
        law: ρ.
    """

    variances: Sequence[FloatArray]
    sizes: FloatArray
    law: float

    @classmethod
    def at(cls, problem: Problem, theta: FloatArray, deviation: FloatArray | None = None) -> Errors:
        """Return the errors at (K,) sizes ± deviations."""
        return cls(problem.errors(theta, deviation), np.abs(theta), problem.law)


@dataclass(frozen=True)
class Fit:
    """The estimate under one prior.

    Attributes:
        theta: (K,) estimate of every parameter.
        errors: of the model.
        groupwise: likelihood of θ around the estimate, by secants, with the errors of each group alone.
        groups: of all experiments, in their order, at the estimate.
        kinds: of motion, of each of these groups: "" for a test of the specification, or the protocol.
        variances: of these groups.
    """

    theta: FloatArray
    errors: Errors
    groupwise: Likelihood
    groups: Groups
    kinds: tuple[str, ...]
    variances: Variances

    @cached_property
    def likelihood(self) -> Likelihood:
        """The likelihood of θ around the estimate, with all errors; the prior is not in it."""
        return with_shared_error(with_form_error(self.groupwise, self.form), self.shared)

    def information_left(self, difference: FloatArray) -> float:
        """Return the part of a difference of log evidence that errors of form leave; see :func:`information_left`.

        Args:
            difference: (G,) mean squared difference of two predictions in each group, in u.
        """
        apart = self.groups.size / self.variances.noise * difference
        return information_left(apart, self.errors.law * self.errors.sizes, self.by_group, self.kinds)

    @cached_property
    def by_group(self) -> FloatArray:
        """(G, K, K) information of every group, with its own law error."""
        return information_by_group(self.groups, self.errors.sizes, self.variances)

    @cached_property
    def form(self) -> FloatArray:
        """(K, K) Q, the covariance of the score by errors of form."""
        errors = self.errors
        return form_error(errors.law, errors.sizes, self.by_group, self.kinds, self.groupwise.information)

    @cached_property
    def shared(self) -> FloatArray:
        """(K,) variance of the error of size that all groups share."""
        sizes = self.errors.sizes
        return shared_error(sizes, disagreement(self.groups, sizes, self.variances))


def fit(
    problem: Problem,
    start: FloatArray | None = None,
    deviation: FloatArray | None = None,
    errors: Errors | None = None,
) -> Fit:
    """Return the joint estimate.

    Args:
        problem: data and prior.
        start: (K,) first estimate; the search finds one without it.
        deviation: (K,) prior standard deviation of every size in the fit; without it, that of a cause.
        errors: of the model; without them, those at the start, of law at the larger of the start and ``deviation``.
    """
    observations, prior = problem.observations, problem.prior
    effects = prior.low.size
    deviation = np.full(effects, SLAB) if deviation is None else deviation
    theta = search(problem) if start is None else np.clip(start, prior.low, prior.high)
    if errors is None:
        wide = np.maximum(np.abs(theta), deviation)
        errors = Errors(problem.errors(theta), wide, problem.law)
    components = Variances.prior(sum(len(one.parts) for one in observations))
    groups = _group(problem, theta, errors)
    for step in range(STEPS):
        components = variances(groups, errors.sizes, components, 2 if step == 0 else 1)
        total = likelihood(groups, errors.sizes, components)
        moved = _step(total, theta, deviation) * (FIRST if step < 2 else 1.0)
        new = np.clip(theta + moved, prior.low, prior.high)
        if np.abs(new - theta).max(initial=0.0) < CLOSE:
            break
        theta = new
        groups = _group(problem, theta, errors)
    # The evidence of two fits can be compared only where their variances have settled.
    components = variances(groups, errors.sizes, components, ROUNDS)
    secant_likelihood = likelihood(_group(problem, theta, errors, secants=True), errors.sizes, components)
    kinds = tuple(one.response.experiment.protocol for one in observations for _ in one.parts)
    return Fit(theta, errors, without_variants(secant_likelihood, effects), groups, kinds, components)


def _group(problem: Problem, theta: FloatArray, errors: Errors, secants: bool = False) -> Groups:
    """Return the groups of all experiments at θ."""
    pairs = zip(problem.observations, errors.variances, strict=True)
    return Groups.joined([one.groups(theta, own, secants) for one, own in pairs])


def _step(total: Likelihood, theta: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return (K,) the Gauss–Newton step of θ; the variants' amounts start from 0 at every step."""
    effects = theta.size
    precision = np.ones(len(total.score))
    precision[:effects] = 1.0 / deviation**2
    gradient = total.score.copy()
    gradient[:effects] -= theta / deviation**2
    return np.asarray(np.linalg.solve(total.information + np.diag(precision), gradient)[:effects])


def search(problem: Problem, start: FloatArray | None = None) -> FloatArray:
    """Return (K,) a first estimate: from a start, one parameter at a time moves to a point of the library.

    A parameter moves together with those that depend on it, such as the phase of a ripple: they show nothing while it
    is nominal. A move is compared with the present estimate under the larger of both errors u. Most moves do not change
    their gain much: those that gained most are tried first, and all others only when none of these gains any more.
    """
    observations = problem.observations
    theta = np.zeros(problem.prior.low.size) if start is None else start.copy()
    tables = [_Table.of(problem, members, theta) for members in _coupled(problem)]
    moves = [(k, j) for k, table in enumerate(tables) for j in range(len(table.points))]
    place = [table.points.index(tuple(theta[table.members].tolist())) for table in tables]
    residuals = [one.residual(theta) for one in observations]
    errors = problem.errors(theta)
    few = moves
    for _ in range(4 * theta.size):
        gains = {
            (k, j): tables[k].gain(observations, residuals, errors, place[k], j)
            for k, j in few
            if j != place[k]
        }
        first = max(gains, key=lambda move: gains[move], default=None)
        if first is None or gains[first] < GAIN:
            if few is moves:
                break
            few = moves
            continue
        few = sorted(gains, key=lambda move: -gains[move])[:TRIED]
        k, j = first
        for e in range(len(observations)):
            residuals[e] = residuals[e] + tables[k].values[e][place[k]] - tables[k].values[e][j]
            errors[e] = errors[e] + tables[k].errors[e][j] - tables[k].errors[e][place[k]]
        few = [move for move in few if move[0] != k] + [(k, j) for j in range(len(tables[k].points))]
        place[k] = j
    for table, j in zip(tables, place, strict=True):
        theta[table.members] = table.points[j]
    return theta


def _coupled(problem: Problem) -> list[list[int]]:
    """Return the parameters that move together: each that stands alone, and those that depend on it."""
    dependence = problem.observations[0].dependence
    return [
        [k, *np.flatnonzero(dependence.base == k).tolist()]
        for k in np.flatnonzero(dependence.base < 0).tolist()
    ]


@dataclass(frozen=True)
class _Table:
    """Responses of a parameter and its dependents at some points and their variances, for every experiment."""

    members: list[int]
    points: list[tuple[float, ...]]
    values: list[FloatArray]
    errors: list[FloatArray]

    @classmethod
    def of(cls, problem: Problem, members: list[int], theta: FloatArray) -> _Table:
        points = sorted({tuple(theta[members].tolist()), *_points(problem, members)})
        values, errors = [], []
        for one in problem.observations:
            row, own = [], []
            for point in points:
                factors = [1.0, *(point[0] / one.dependence.at[k] for k in members[1:])]
                each = list(zip(members, point, factors, strict=True))
                row.append(sum((f * one.curves[k].at(x) for k, x, f in each), np.zeros(len(one.observed))))
                own.append(sum((f**2 * one.error(k, x) for k, x, f in each), np.zeros(len(one.observed))))
            values.append(np.array(row))
            errors.append(np.array(own))
        return cls(members, points, values, errors)

    def gain(
        self,
        observations: Sequence[Observation],
        residuals: Sequence[FloatArray],
        errors: Sequence[FloatArray],
        now: int,
        then: int,
    ) -> float:
        """Return how much a move from one point to another lowers loss and prior."""
        before, after = (float(np.sum(np.square(self.points[place]))) for place in (now, then))
        gain = 0.5 * (before - after) / SLAB**2
        for one, r, e, v, own in zip(observations, residuals, errors, self.values, self.errors, strict=True):
            unit = one.unit(e + np.maximum(own[then] - own[now], 0.0))
            gain += one.loss(r, unit) - one.loss(r + v[now] - v[then], unit)
        return gain


def _points(problem: Problem, members: list[int]) -> list[tuple[float, ...]]:
    """Return the points of a parameter with all its dependents nominal, then with one of them at a time.

    The first has those of the library, the middle between two, and a quarter of the first. Beside a dependent it has
    those of the library alone.
    """
    base, rest = members[0], members[1:]
    simulated = _library_coordinates(problem, base)
    if simulated.size < 2:
        return []
    first = np.array(
        [simulated[simulated > 0].min(initial=np.inf), simulated[simulated < 0].max(initial=-np.inf)]
    )
    alone = np.concatenate(
        [simulated, (simulated[1:] + simulated[:-1]) / 2.0, 0.25 * first[np.isfinite(first)]]
    )
    nominal = (0.0,) * len(rest)
    points = [(x, *nominal) for x in _in_range(problem, base, alone)]
    for place, k in enumerate(rest):
        for d in _in_range(problem, k, _library_coordinates(problem, k)):
            beside = (*nominal[:place], d, *nominal[place + 1 :])
            points += [(x, *beside) for x in _in_range(problem, base, simulated) if x and d]
    return points


def _library_coordinates(problem: Problem, parameter: int) -> FloatArray:
    """Return the coordinates at which the library has some response to a parameter, and 0."""
    return np.unique(
        np.concatenate([[0.0], *(one.curves[parameter].coordinates for one in problem.observations)])
    )


def _in_range(problem: Problem, parameter: int, coordinates: FloatArray) -> list[float]:
    low, high = problem.prior.low[parameter], problem.prior.high[parameter]
    return [float(x) for x in np.clip(coordinates, low, high)]
