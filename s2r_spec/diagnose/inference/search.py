"""The first estimate: a search over the points of the library.

Data and error: :mod:`.observation`. From a start, one parameter at a time, with its dependents, moves to the point that
lowers

    Σ_g ½ (ν + N_g) log(1 + N_g |r_g|²/(n_g ν)) + ½ |θ|²/σ_slab²      (Student's t for each group)

the most, until none lowers it by more than :data:`GAIN`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.observation import Observation, Problem
from s2r_spec.diagnose.inference.prior import SLAB

GAIN = 2.0
"""Tolerance: least gain of a step of the search, in log-likelihood; the odds of one step change by a factor of 7."""
TRIED = 40
"""Budget: moves of the search that are tried before all others."""


def search(problem: Problem, start: FloatArray | None = None) -> FloatArray:
    """Return (K,) a first estimate, from a start or from 0.

    A parameter moves together with those that depend on it, such as the phase of a ripple: they show nothing while it
    is nominal. A move is compared with the present estimate under the larger of both errors u. Most moves do not change
    their gain much: those that gained most are tried first, and all others only when none of these gains any more.
    """
    observations = problem.observations
    theta = np.zeros(problem.prior.low.size) if start is None else start.copy()
    base = observations[0].dependence.base
    coupled = [[k, *np.flatnonzero(base == k).tolist()] for k in np.flatnonzero(base < 0).tolist()]
    tables = [_Table.of(problem, members, theta) for members in coupled]
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

    def simulated(parameter: int) -> FloatArray:
        every = [one.curves[parameter].coordinates for one in problem.observations]
        return np.unique(np.concatenate([[0.0], *every]))

    def in_range(parameter: int, coordinates: FloatArray) -> list[float]:
        low, high = problem.prior.low[parameter], problem.prior.high[parameter]
        return [float(x) for x in np.clip(coordinates, low, high)]

    (base, *rest), known = members, simulated(members[0])
    if known.size < 2:
        return []
    first = np.array([known[known > 0].min(initial=np.inf), known[known < 0].max(initial=-np.inf)])
    alone = np.concatenate([known, (known[1:] + known[:-1]) / 2.0, 0.25 * first[np.isfinite(first)]])
    nominal = (0.0,) * len(rest)
    points = [(x, *nominal) for x in in_range(base, alone)]
    for place, k in enumerate(rest):
        for d in in_range(k, simulated(k)):
            beside = (*nominal[:place], d, *nominal[place + 1 :])
            points += [(x, *beside) for x in in_range(base, known) if x and d]
    return points
