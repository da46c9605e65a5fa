"""How large the named effects are, with intervals."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import Design
from s2r_spec.diagnose.logs import logsumexp

FloatArray = NDArray[np.float64]

COVER = 0.9
"""Probability of the intervals."""
SECOND = 0.01
"""Part of the energy that a second parameter of an effect must explain to be used."""
FINE = 9
"""Points of the refined grid around the best fit, per line."""


@dataclass(frozen=True)
class Estimate:
    """A parameter of a named effect.

    Attributes:
        effect: name.
        parameter: name.
        value: estimate, in ``unit``.
        low: of the 90 % interval.
        high: of the 90 % interval.
        unit: of the three.
    """

    effect: str
    parameter: str
    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Fit:
    """The best values of a set of effects.

    Attributes:
        estimates: one a parameter that is off nominal.
        values: what :meth:`HasEffects.with_effects` takes.
        left: part of the data's energy that is not explained.
    """

    estimates: tuple[Estimate, ...]
    values: dict[str, dict[str, float]]
    left: float
    at: dict[int, float] = field(default_factory=dict)
    """Line of the catalogue → coordinate."""


def fit(design: Design, z: FloatArray, effects: Sequence[int], temperature: float) -> Fit:
    """Fit the lines of some effects together, by coordinate descent along the interpolated signatures.

    Of an effect with several parameters those are used that lower the misfit by more than a hundredth.
    """
    c = design.candidates
    energy = float(z @ z) / len(z)
    exponent = round(0.5 * np.log2(max(energy, 1e-12))) - 3
    root = design.level(exponent).root
    y = z * root
    total = float(y @ y)
    lines = sorted({int(i) for k in effects for i in c.line[c.effect == k]})
    knots = {i: _knots(design, i, root) for i in lines}
    at = dict.fromkeys(lines, 0.0)

    def misfit(places: dict[int, float]) -> float:
        rest = y - sum((_along(knots[i], v) for i, v in places.items()), np.zeros_like(y))
        return float(rest @ rest)

    owner = {i: next(k for k in effects if (c.line[c.effect == k] == i).any()) for i in lines}
    used: list[int] = []
    while len(used) < 2 * len(effects):
        covered = {owner[i] for i in used}
        # Every effect gets a line first; a second one must earn its place.
        open_ = [i for i in lines if i not in used and (owner[i] not in covered or covered >= set(effects))]
        if not open_:
            break
        options = [(i, *_descend(knots[i], _cost(misfit, at, i))) for i in open_]
        best, value, cost = min(options, key=lambda option: option[2])
        if covered >= set(effects) and misfit(at) - cost < SECOND * total:
            break
        used.append(best)
        at[best] = value
        for i in used * 2:
            at[i], _ = _descend(knots[i], _cost(misfit, at, i))
    at = {i: at[i] for i in used}
    cost = misfit(at)
    found: list[Estimate] = []
    values: dict[str, dict[str, float]] = {}
    for i in used:
        line = design.signatures.curves[i].line
        low, high = _interval(knots[i], _cost(misfit, at, i), cost, temperature)
        ends = sorted((line.value(low), line.value(high)))
        value = line.value(at[i])
        found.append(Estimate(line.effect, line.parameter, value, ends[0], ends[1], line.unit))
        values.setdefault(line.effect, {}).update(
            {**line.base, **values.get(line.effect, {}), line.parameter: value}
        )
    return Fit(tuple(found), values, cost / total, at)


def signature(design: Design, fitted: Fit) -> FloatArray:
    """Return (D,): what the bank says of a fit, each effect by itself."""
    plain = np.ones(len(design.spectrum))
    total = np.zeros(len(design.spectrum))
    for line, value in fitted.at.items():
        total += _along(_knots(design, line, plain), value)
    return total


def _cost(
    misfit: Callable[[dict[int, float]], float], at: dict[int, float], line: int
) -> Callable[[float], float]:
    """Return the misfit as a function of one line's coordinate."""
    return lambda value: misfit(at | {line: value})


def _knots(design: Design, line: int, root: FloatArray) -> tuple[FloatArray, FloatArray]:
    c = design.candidates
    mine = np.flatnonzero(c.line == line)
    at = np.append(c.coordinate[mine], 0.0)
    mu = np.concatenate([c.mu[mine] * root, np.zeros((1, c.mu.shape[1]))])
    order = np.argsort(at)
    return at[order], mu[order]


def _along(knots: tuple[FloatArray, FloatArray], value: float) -> FloatArray:
    at, mu = knots
    if value == 0.0:
        return np.zeros(mu.shape[1])
    high = int(np.clip(np.searchsorted(at, value), 1, len(at) - 1))
    part = (value - at[high - 1]) / (at[high] - at[high - 1])
    found: FloatArray = mu[high - 1] * (1.0 - part) + mu[high] * part
    return found


def _descend(knots: tuple[FloatArray, FloatArray], cost: Callable[[float], float]) -> tuple[float, float]:
    """Return the best coordinate on a line and its cost: the knots, then between them."""
    at = knots[0]
    costs = np.array([cost(float(v)) for v in at])
    best = int(costs.argmin())
    low, high = at[max(best - 1, 0)], at[min(best + 1, len(at) - 1)]
    fine = np.linspace(low, high, FINE)
    fine_costs = np.array([cost(float(v)) for v in fine])
    place = int(fine_costs.argmin())
    return (
        (float(fine[place]), float(fine_costs[place]))
        if fine_costs[place] < costs[best]
        else (
            float(at[best]),
            float(costs[best]),
        )
    )


def _interval(
    knots: tuple[FloatArray, FloatArray], cost: Callable[[float], float], best: float, temperature: float
) -> tuple[float, float]:
    """Return the coordinates between which the tempered posterior along a line has 90 % of its mass."""
    at = knots[0]
    fine = np.unique(np.concatenate([np.linspace(a, b, 6) for a, b in itertools.pairwise(at)]))
    logs = np.array([-0.5 * (cost(float(v)) - best) for v in fine]) / max(temperature, 1.0)
    mass = np.exp(logs - logsumexp(logs)) * np.gradient(fine)
    cumulative = np.cumsum(mass) / mass.sum()
    ends = np.interp([(1 - COVER) / 2, (1 + COVER) / 2], cumulative, fine)
    return float(ends[0]), float(ends[1])
