"""Real data of one experiment beside the simulator's responses, and the error of each observable.

Data: y (m,), the mean observables of the real runs. Model: the simulator's mean at θ is its nominal mean, the sum of
the library's responses, and a correction from runs at an estimate, which holds the interactions of effects. The error
of an observable i of group g has the shape

    u_i² = scatter² + variants² + background² + Σ_k [(ρ F_k,i)² + (κ_g ΔF_k,i)² + bend_k,i² + θ_k² spread_k,i²]

F_k is the response to parameter k, of which another author's law differs by a part ρ. ΔF_k is its change since the last
runs of the simulator, and κ_g the relative error of a sum of responses (:mod:`.additivity`). *bend* is the error of
interpolation, and *spread* the scatter of a response from run to run. So a group that an effect throws into
disorder says little about this effect. *background* is the error of sum and scatter at σ_bg of every parameter. Half of
the sum and of the background is spread evenly over the group.

Units: θ in typical sizes. Shapes: m observables, of which n are used, in G groups; K parameters, V variants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.additivity import relative_errors
from s2r_spec.diagnose.inference.calibration import calibrated_curves
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LARGEST, LAW_SHARE, Groups
from s2r_spec.diagnose.inference.prior import BACKGROUND, SizePrior
from s2r_spec.diagnose.simulator.curve import Curves
from s2r_spec.diagnose.simulator.response import Dependence, Response


@dataclass(frozen=True)
class Observation:
    """Real data of one experiment, and the simulator's responses.

    Of m observables n are used: those that the real runs, the nominal runs and all responses have.

    Attributes:
        response, dependence: of the simulator to every effect, and which are in proportion to another parameter.
        kept: (n,) places of the observables that are used.
        parts: (quantity, statistic) and places among the n of every group.
        observed: (n,) difference of the real and the nominal mean.
        noise: (n,) variance of this difference by the scatter of the runs and by the variants.
        curves: the response to every parameter, at the points at which the simulator does not fall.
        learned: (K, n) variance of the responses by the scatter of their runs, for a coordinate of 1.
        spread: (K, n) variance of the difference, with this one, since an effect makes real runs scatter more.
        variants: (V, n) responses to the variants.
        coherent, effective, form: (G,) ρ_g and N_g, and (n,) κ_g of the group of every observable.
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
    curves: Curves
    learned: FloatArray
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
        # A point at which the simulator falls is left out: it would take the rest of the trace from all parameters.
        curves = []
        for variant in response.variants:
            usable &= np.isfinite(variant.values).all(axis=0)
        for curve in response.curves:
            stood = np.asarray(np.isfinite(curve.values[:, response.bins]).all(axis=1))
            curves.append(curve.at_points(stood))
            # Some points lack an observable, such as the mean of a phase that does not occur.
            usable &= np.isfinite(curves[-1].values).all(axis=0)
        moved = np.max([np.abs(curve.values).max(axis=0) for curve in curves], axis=0) > 1e-9
        parts, kept, start = [], [], 0
        repeats = _repeats(response, moved & usable)
        for group in response.groups_of(np.isfinite(mean)):
            places = group.start + np.flatnonzero(usable[group.start : group.stop])
            # A group that nothing moves says nothing.
            if group.quantity not in repeats and moved[places].any():
                parts.append(((group.quantity, group.statistic), np.arange(start, start + places.size)))
                kept.append(places)
                start += places.size
        used = np.concatenate([*kept, np.zeros(0, dtype=np.int64)])
        key = used.tobytes(), dependence.base.tobytes(), dependence.at.tobytes(), len(whole)
        if key not in response.calibrated:
            own, learned = calibrated_curves(response, curves, used, parts)
            variants = [
                one.values[-1] for one in calibrated_curves(response, response.variants, used, parts)[0]
            ]
            bare = cls(
                response,
                dependence,
                used,
                tuple(parts),
                np.zeros(used.size),
                np.zeros(used.size),
                own,
                learned,
                learned,
                np.reshape(variants, (len(response.variants), used.size)),
                np.full(len(parts), LAW_SHARE),
                np.array([float(places.size) for _, places in parts]),
                np.full(used.size, LAW_SHARE),
                np.zeros(used.size),
                np.zeros(len(curves)),
                np.ones(used.size, dtype=bool),
            ).of_runs(len(whole))
            response.calibrated[key] = bare._calibrated() if parts else bare
        found: Observation = response.calibrated[key]
        return replace(found, observed=(mean - response.nominal)[used])

    def of_runs(self, runs: int) -> Observation:
        """Return the observation with the scatter of the mean of so many real runs."""
        response, used = self.response, self.kept
        noise = response.scatter[used] ** 2 / runs + (self.variants**2).sum(axis=0)
        return replace(self, noise=noise, spread=response.spread[:, used] / runs + self.learned)

    def corrected(self, correction: FloatArray, theta: FloatArray) -> Observation:
        """Return the observation with (m,) another correction of the simulator's mean, from runs at θ.

        It is NaN where a run has no value; there the sum of responses counts.
        """
        exact = np.isfinite(correction[self.kept])
        new = np.where(exact, correction[self.kept], 0.0)
        return replace(self, correction=new, ran=theta, exact=exact)

    def moved(self, theta: FloatArray) -> FloatArray:
        """Return (n,) the sum of the responses at θ."""
        factors = self.dependence.factors(theta)[:, None]
        return np.asarray((factors * self.curves.at(theta)).sum(axis=0))

    def squares(self, theta: FloatArray) -> FloatArray:
        """Return (n,) the sum of the squares of the responses at θ."""
        factors = self.dependence.factors(theta)[:, None]
        return np.asarray(np.square(factors * self.curves.at(theta))[theta != 0.0].sum(axis=0))

    def residual(self, theta: FloatArray) -> FloatArray:
        """Return (n,) the residual at θ."""
        return self.observed - self.correction - self.moved(theta)

    def columns(self, theta: FloatArray, secants: bool = False) -> FloatArray:
        """Return (K + V, n) the tangents of all responses at θ, or their secants from nominal, then the variants."""
        if secants:
            slopes = np.array([c.secant(x) for c, x in zip(self.curves, theta.tolist(), strict=True)])
        else:
            slopes = self.curves.slope(theta)
        slopes = self.dependence.factors(theta)[:, None] * slopes
        for k, base in self.dependence.pairs:
            slopes[base] += self.curves[k].at(float(theta[k])) / self.dependence.at[k]
        return np.vstack([slopes, self.variants])

    def error(self, parameter: int, size: float, deviation: float = 0.0) -> FloatArray:
        """Return (n,) the variance of a response of this size ± deviation.

        Where the simulator ran, the sum of responses and the interpolation have no error.
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
        deviation = np.zeros_like(theta) if deviation is None else deviation
        numbers = zip(*(x.tolist() for x in (self.dependence.factors(theta), theta, deviation)), strict=True)
        each = [f**2 * self.error(k, x, d) for k, (f, x, d) in enumerate(numbers)]
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
        return self.reduced(self.residual(theta), self.columns(theta, secants), errors)

    def reduced(self, residual: FloatArray, columns: FloatArray, errors: FloatArray) -> Groups:
        """Return the groups of (n,) a residual and (K + V, n) columns, under the error of (n,) these variances."""
        parts = [slice(start, start + count) for start, count in zip(*self._layout, strict=True)]
        return Groups.of(residual, columns, self.unit(errors), parts, self.coherent, self.effective)

    def _calibrated(self) -> Observation:
        """Return the observation with the relative errors that the practice machines show."""
        practice = self.response.practice
        sums = np.array([self.moved(theta) for theta in practice.theta])
        rest = practice.values[:, self.kept] - self.response.nominal[self.kept] - sums
        rest = rest - practice.variant @ self.variants
        runs = self.response.scatter[self.kept] ** 2
        # The error of the sum itself: interpolation and scatter, without form.
        plain = replace(self.of_runs(1), law=0.0, form=np.zeros_like(self.form))
        noise = np.sqrt([runs + plain.errors(theta) + self._background + 1e-24 for theta in practice.theta])
        coherent, other, size = relative_errors(sums, rest, noise, self._places)
        return replace(self, coherent=coherent, effective=size, form=np.repeat(other, self._layout[1]))

    @cached_property
    def _where_ran(self) -> list[tuple[FloatArray, FloatArray]]:
        """Response (n,) to each parameter where the simulator ran, and its bend; 0 where that run has no value."""
        places = zip(self.curves, self.ran.tolist(), strict=True)
        return [(self.exact * c.at(x), self.exact * c.bend(x)) for c, x in places]

    @cached_property
    def _background(self) -> FloatArray:
        ends = [self.curves.at(np.full(len(self.curves), end)) for end in (-BACKGROUND, BACKGROUND)]
        each = np.mean([self.form**2 * own**2 for own in ends], axis=0)
        return np.asarray(each.sum(axis=0) + BACKGROUND**2 * self.spread.sum(axis=0))

    @property
    def _places(self) -> list[NDArray[np.int64]]:
        return [places for _, places in self.parts]

    @cached_property
    def _layout(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Begin and size of every group."""
        return np.array([each[0] for each in self._places]), np.array([each.size for each in self._places])


def _repeats(response: Response, moved: NDArray[np.bool_]) -> set[str]:
    """Return the differences of two channels of which no effect moves one: they repeat the other, and say nothing new.

    Such a channel is a reference that is the same in every run of the experiment.
    """
    moving = {g.quantity for g in response.observables.groups if moved[g.start : g.stop].any()}
    every = response.observables.quantities
    return {one.name for one in every if one.minus and not {one.channel, one.minus} <= moving}


@dataclass(frozen=True)
class Problem:
    """What is to be estimated from what: an observation of each experiment, and the prior of the sizes."""

    observations: tuple[Observation, ...]
    prior: SizePrior

    def errors(self, theta: FloatArray, deviation: FloatArray | None = None) -> list[FloatArray]:
        """Return (n_p,) the variances of all responses at θ ± (K,) deviations, for every experiment."""
        return [one.errors(theta, deviation) for one in self.observations]
