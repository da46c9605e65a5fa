"""All of the catalogue at once: a Gauss–Newton fit whose residual is the simulator itself.

Every line gets a coordinate, small unless the data want it otherwise. Where the
fit ends, what the simulator leaves unexplained is free of the errors of any
surrogate: interpolation over the test space, interpolation along a line,
interactions of effects. Around that point the data are linear in the
coordinates, and sets of effects can be compared exactly
(:mod:`s2r_spec.diagnose.evidence`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Ends = tuple[float, float]

ROUNDS = 5
SHORT = 3
"""The same where the derivatives are known to begin with."""
RIDGE = 0.3
"""Standard deviation of a coordinate before the data are seen: between a little of everything and a typical effect."""
TURN = 0.5
"""The same for a coordinate that says how another acts (a phase, a place), around where the search starts."""
HALVES = (1.0, 0.5, 0.2)
"""Parts of a step that are tried."""
DONE = 0.05
"""A step that lowers the cost by less than this part of it is the last."""
PROMISED = 0.02
"""One that the derivatives promise to lower it by less than this part is not taken: each is rollouts."""


REACHES = (0.4, 0.2, 0.1)
"""Steps of a search along single lines, as parts of a coordinate."""
SAME = 0.05
"""Steps with which is felt how far a value may move without any change, as parts of a coordinate."""
PLACES = 16
"""Equal steps over a line, or over either side of it, at which a coordinate is tried that no derivative leads to."""
SOME = 10.0
"""By how much it must lower what a fit leaves, in units of what is believed, to be followed."""


class Lines(Protocol):
    """What some lines do, at the real tests."""

    lower: FloatArray
    """(K,) ends of the lines."""
    upper: FloatArray
    based: NDArray[np.bool_]
    """(K,) which lines only say how another of the same effect acts."""

    def change(self, at: FloatArray) -> FloatArray:
        """Return (q, k) change from nominal, with all lines at (K,) coordinates."""
        ...


class Model(Lines, Protocol):
    """What the whole catalogue does: the simulator, or the bank in its place."""

    def jacobian(self, at: FloatArray) -> FloatArray:
        """Return (K, q, k) derivatives of the change there."""
        ...


@dataclass(frozen=True)
class Joint:
    """A fit.

    Attributes:
        at: (K,) coordinates.
        rest: (q, k) that is left of the data.
        jacobian: (K, q, k).
        misfit: mean square of what neither lines nor nuisances explain, in units of what is believed.
        cost: the same as a sum, and what the coordinates cost by what was believed of them.
    """

    at: FloatArray
    rest: FloatArray
    jacobian: FloatArray
    misfit: float
    cost: float


class _Measure:
    """How much of a remainder neither its variance nor the nuisances explain."""

    def __init__(self, variance: FloatArray, nuisances: FloatArray) -> None:
        self.root = 1.0 / np.sqrt(variance)
        self.nuisances = nuisances.reshape(len(nuisances), variance.size) * self.root.ravel()
        self._inner = np.linalg.inv(np.eye(len(nuisances)) + self.nuisances @ self.nuisances.T)

    def __call__(self, rest: FloatArray) -> float:
        left = (rest * self.root).ravel()
        explained = self.nuisances @ left
        return float(left @ left - explained @ self._inner @ explained)


def joint_fit(
    model: Model,
    data: FloatArray,
    variance: FloatArray,
    nuisances: FloatArray,
    begin: FloatArray,
    first: FloatArray,
    ridge: float | FloatArray = RIDGE,
    exact: bool = False,
) -> Joint:
    """Fit all lines to data (q, k), known up to ``variance`` (q, k).

    Args:
        model: see there; its own derivatives are asked for once, where the first step ends.
        data: coefficients of real less nominal.
        variance: of these.
        nuisances: (v, q, k) that may be there at unit size, and are no line's doing.
        begin: (K,) coordinates to start from.
        first: (K, q, k) derivatives for the first step.
        ridge: standard deviation of a coordinate before the data are seen, one for all or (K,).
        exact: whether ``first`` are the model's own already, so that they are not asked for again.
    """
    measure = _Measure(variance, nuisances)
    middle = np.where(model.based, begin, 0.0)
    prior = np.where(model.based, TURN, ridge) ** -2.0

    def cost(at: FloatArray, rest: FloatArray) -> float:
        return measure(rest) + float((prior * (at - middle) ** 2).sum())

    def wanted(at: FloatArray, rest: FloatArray, jacobian: FloatArray) -> FloatArray:
        j = np.concatenate([(jacobian * measure.root).reshape(len(at), -1), measure.nuisances])
        y = ((rest + np.tensordot(at - middle, jacobian, 1)) * measure.root).ravel()
        weight = np.concatenate([prior, np.ones(len(nuisances))])
        found: FloatArray = np.linalg.solve(j @ j.T + np.diag(weight), j @ y)
        return middle + found[: len(at)]

    at, jacobian = begin, first
    change = model.change(at) if np.any(begin[~model.based]) else np.zeros_like(data)
    rest = data - change
    best = cost(at, rest)
    own = exact
    for _ in range(SHORT if exact else ROUNDS):
        aim = wanted(at, rest, jacobian)
        accepted = small = False
        full = np.clip(aim, model.lower, model.upper) - at
        promise = best - cost(at + full, rest - np.tensordot(full, jacobian, 1))
        for part in HALVES if promise > PROMISED * best else ():
            there = np.clip(at + part * (aim - at), model.lower, model.upper)
            step = there - at
            if not np.any(step):
                break
            moved = model.change(there)
            # What the simulator did, not what was expected of it (Broyden 1965).
            surprise = moved - change - np.tensordot(step, jacobian, 1)
            jacobian = jacobian + (step / (step @ step))[:, None, None] * surprise
            new = cost(there, data - moved)
            if new < best:
                accepted, small = True, best - new < DONE * best
                at, change, rest, best = there, moved, data - moved, new
                break
        if not own:
            jacobian, own = model.jacobian(at), True
        elif small or not accepted:
            break
    return Joint(at, rest, jacobian, measure(rest) / data.size, best)


def misfit(rest: FloatArray, variance: FloatArray, nuisances: FloatArray) -> float:
    """Return the mean square of what the nuisances do not explain of a rest (q, k), in units of what is believed."""
    return _Measure(variance, nuisances)(rest) / rest.size


def seen_through(fitted: Joint, project: FloatArray, variance: FloatArray, nuisances: FloatArray) -> Joint:
    """Return a fit to data at every test as what it is to functions of the test, ``project`` (q, n) of them."""
    rest = project @ fitted.rest
    jacobian = np.einsum("qn,lnk->lqk", project, fitted.jacobian)
    return Joint(fitted.at, rest, jacobian, misfit(rest, variance, nuisances), fitted.cost)


def rephased(
    model: Model,
    data: FloatArray,
    variance: FloatArray,
    nuisances: FloatArray,
    at: FloatArray,
    ridge: float,
) -> FloatArray:
    """Return coordinates that were fitted again from the best place of every based line, where that is better.

    A phase has more than one valley, and derivatives lead into the next one only.
    """
    for line in np.flatnonzero(model.based).tolist():
        costs = _along(model, data, variance, nuisances, at, line)
        best = min(costs, key=lambda x: costs[x])
        if costs[best] < costs[float(at[line])] - SOME:
            there = at.copy()
            there[line] = best
            first = model.jacobian(there)
            at = joint_fit(model, data, variance, nuisances, there, first, ridge, exact=True).at
    return at


def reach(
    model: Lines,
    data: FloatArray,
    variance: FloatArray,
    nuisances: FloatArray,
    at: FloatArray,
    line: int,
    near: float,
) -> Ends:
    """Return the least and the largest coordinate of a based line that cost no more than ``near`` above the best."""
    costs = _along(model, data, variance, nuisances, at, line)
    most = min(costs.values()) + near
    likely = [x for x, cost in costs.items() if cost <= most]
    return min(likely), max(likely)


def _along(
    model: Lines, data: FloatArray, variance: FloatArray, nuisances: FloatArray, at: FloatArray, line: int
) -> dict[float, float]:
    """Return coordinate → what the model leaves of the data there, all over a line and where it is."""
    measure = _Measure(variance, nuisances)
    costs = {}
    for x in (float(at[line]), *np.linspace(model.lower[line], model.upper[line], PLACES + 1).tolist()):
        there = at.copy()
        there[line] = x
        costs[x] = measure(data - model.change(there))
    return costs


def polished(
    model: Lines, data: FloatArray, variance: FloatArray, nuisances: FloatArray, at: FloatArray, ridge: float
) -> FloatArray:
    """Return coordinates that are at least as good, by steps along one line at a time.

    A delay in whole samples, or friction that holds, has no derivative to follow.
    """
    measure = _Measure(variance, nuisances)

    def cost(there: FloatArray) -> float:
        return measure(data - model.change(there)) + float(((there[~model.based] / ridge) ** 2).sum())

    best = cost(at)
    for reach in REACHES:
        for line in np.flatnonzero(~model.based):
            for side in (1.0, -1.0):
                there = at.copy()
                there[line] += side * reach * max(abs(at[line]), RIDGE)
                there = np.clip(there, model.lower, model.upper)
                if np.any(there != at) and (new := cost(there)) < best:
                    at, best = there, new
                    break
    for line in np.flatnonzero(~model.based):
        at = _centred(model, at, int(line))
    return at


def _centred(model: Lines, at: FloatArray, line: int) -> FloatArray:
    """Return coordinates in the middle of what the simulator does not tell from them: whole samples of a delay."""
    here = model.change(at)
    step = SAME * max(abs(at[line]), RIDGE)
    ends = []
    for side in (-1.0, 1.0):
        reached = at[line]
        for number in range(1, 1 + round(1.0 / SAME)):
            there = at.copy()
            there[line] = np.clip(at[line] + side * number * step, model.lower[line], model.upper[line])
            if there[line] == reached or not np.array_equal(model.change(there), here):
                break
            reached = there[line]
        ends.append(reached)
    middle = at.copy()
    middle[line] = (ends[0] + ends[1]) / 2.0
    return middle
