"""Which machine of the catalogue the recordings could be of: a fit of a few effects, simulated exactly.

Model: r = Σ_k g_k(x_k) + ε, ε ~ N(0, C), with g_k the changes along line k at coordinate x_k, straight between the
values that were simulated. Estimator: lines are added one at a time while they explain enough; each coordinate is the
best on a grid. What several effects do together, and between the values, is put right by simulating the fitted
machine and fitting what is left (Gauss–Newton with the nominal derivatives).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line, Values
from s2r_spec.diagnose.quality.comparison import BUDGET, LEAST, Comparison, noise
from s2r_spec.diagnose.simulate import Bench

FloatArray = NDArray[np.float64]
Chosen = Mapping[int, int]
"""Number of a line → place on its grid."""

EFFECTS = 3
"""Definition: effects that a machine has at most, lines that are tried by simulation, and machines of several effects
that are simulated. Twice as many fit recordings of several effects nearer, at twice the time."""
MOST = 18
"""Budget: machines of one effect that are simulated at most. Twice as many find effects that are far from linear in
more cases."""
SEEDS = 2
"""Budget: rollouts a test of each; twice as many halve the variance of its mean."""
PLACES = 41
"""Definition: coordinates of a line that are tried. Twice as many are a finer grid."""
WORTH = 0.02
"""Tolerance: part of the misfit that a further effect must explain; twice as much leaves small ones out."""


@dataclass(frozen=True, eq=False)
class _Curve:
    """A line: from places on a grid to weights of the simulated changes.

    Attributes:
        line: see there.
        grid: (PLACES,) coordinates over the range that was simulated.
        table: (PLACES, k) weights of the changes that are those of the line there, straight between values.
    """

    line: Line
    grid: FloatArray
    table: FloatArray

    @classmethod
    def of(cls, line: Line, sizes: Sequence[tuple[Line, float]]) -> _Curve:
        """Return the curve of a line from all k simulated changes."""
        mine = {
            line.coordinate(value): k for k, (other, value) in enumerate(sizes) if other.name == line.name
        }
        nodes = sorted([*mine, 0.0])
        grid = np.linspace(nodes[0], nodes[-1], PLACES)
        table = np.zeros((PLACES, len(sizes)))
        for x, k in mine.items():
            table[:, k] = np.interp(grid, nodes, np.equal(nodes, x).astype(float))
        return cls(line, grid, table)

    def at(self, place: int) -> Values:
        """Return the machine with the line at a place."""
        return self.line.at(self.line.value(float(self.grid[place])))


@dataclass(frozen=True, eq=False)
class _Fit:
    """A misfit q − 2 wᵀt + wᵀGw of weights w; see :meth:`Comparison.moments`."""

    q: float
    toward: FloatArray
    gram: FloatArray

    def left(self, w: FloatArray) -> FloatArray:
        """Return (…,) the misfit of (…, k) weights."""
        return np.asarray(self.q - 2.0 * w @ self.toward + ((w @ self.gram) * w).sum(axis=-1))


def nearest(
    bench: Bench, c: Comparison, values: FloatArray, executor: Callable[[], Executor] | None = None
) -> Comparison:
    """Return the comparison with the machine that explains recordings best in the nominal one's place.

    The nominal one itself where no machine does better, or a rollout costs too much to try.
    """
    curves = [_Curve.of(line, c.sizes) for line in {line.name: line for line, _ in c.sizes}.values()]
    looks = int(BUDGET / (c.cost * SEEDS * len(c.tests)))
    if not curves or looks < EFFECTS:
        return c

    def beside(chosen: Chosen) -> Comparison | None:
        mean = c.simulated(bench, _machine(curves, chosen), c.tests, SEEDS, executor).mean(axis=1)
        return replace(c, nominal=mean) if np.isfinite(mean).all() else None

    chosen, least = _exact(c, values, curves, beside, min(looks // 2, MOST))
    if not chosen:
        return c
    for _ in range(EFFECTS):
        # What is left of the best machine is fitted with the nominal derivatives, and simulated again.
        now = beside(chosen)
        if now is None:
            break
        further = _further(curves, now, values, chosen)
        other = beside(further)
        if other is None or (left := other.misfit(values)) >= least:
            break
        chosen, least = further, left
    return _rebased(bench, c, _machine(curves, chosen), executor)


def _rebased(
    bench: Bench, c: Comparison, machine: Values, executor: Callable[[], Executor] | None
) -> Comparison:
    """Return the comparison with a machine, and its own scatter, in place of the nominal one."""
    runs = c.simulated(bench, machine, c.tests, c.affordable(len(c.tests)) + 1, executor).swapaxes(0, 1)
    if not np.isfinite(runs).all():
        return c
    mean, floor, scatter = noise(runs[:-1])
    shape = (len(c.effects), len(c.tests), *c.nominal.shape[1:])
    effects = (c.effects.reshape(shape) * (c.floor / floor)).reshape(c.effects.shape)
    made = replace(c, nominal=mean, floor=floor, scatter=scatter, effects=effects)
    return replace(made, usual=max(made.misfit(runs[-1]), LEAST))


def _exact(
    c: Comparison,
    values: FloatArray,
    curves: Sequence[_Curve],
    beside: Callable[[Chosen], Comparison | None],
    looks: int,
) -> tuple[Chosen, float]:
    """Return the line and its place that explain most by themselves, by simulation, and Q.

    The lines that look best along their curves are tried, at values around the best of these.
    """
    fit = _Fit(*c.moments(values))
    left = [fit.left(curve.table) for curve in curves]
    best: Chosen = {}
    least, tried = c.misfit(values), 0
    for n in sorted(range(len(curves)), key=lambda n: float(left[n].min()))[:EFFECTS]:
        grid = curves[n].grid
        place, mine = int(left[n].argmin()), np.inf
        for step in (5, 2, 1):
            for at in np.clip([place - step, place, place + step], 0, PLACES - 1).tolist():
                if not grid[at] or tried >= looks:
                    continue
                tried += 1
                there = beside({n: at})
                found = np.inf if there is None else there.misfit(values)
                if found < mine:
                    mine, place = found, at
                if found < least:
                    least, best = found, {n: at}
    return best, least


def _further(curves: Sequence[_Curve], now: Comparison, values: FloatArray, chosen: Chosen) -> Chosen:
    """Return line → place of the few lines that explain most, its own included, near a machine."""
    q, toward, gram = now.moments(values)
    w = np.sum([curves[n].table[place] for n, place in chosen.items()], axis=0)
    # The machine that was simulated stands for its own weights; others are tried in their place.
    fit = _Fit(q + float(2.0 * toward @ w + w @ gram @ w), toward + gram @ w, gram)
    found: dict[int, int] = {}
    least = fit.q

    def best(n: int) -> tuple[float, int]:
        rest = [curves[m].table[place] for m, place in found.items() if m != n]
        left = fit.left(curves[n].table + np.sum([np.zeros(len(toward)), *rest], axis=0))
        return float(left.min()), int(left.argmin())

    while len(found) < EFFECTS:
        taken = {curves[n].line.effect for n in found}
        tried = [(*best(n), n) for n, curve in enumerate(curves) if curve.line.effect not in taken]
        if not tried or (one := min(tried))[0] > least - WORTH * fit.q:
            break
        least, found[one[2]] = one[0], one[1]
        for _ in range(3 if len(found) > 1 else 0):
            for n in found:
                least, found[n] = best(n)
    return {n: place for n, place in found.items() if curves[n].grid[place]}


def _machine(curves: Sequence[_Curve], chosen: Chosen) -> Values:
    out: dict[str, dict[str, float]] = {}
    for n, place in chosen.items():
        for effect, values in curves[n].at(place).items():
            out.setdefault(effect, {}).update(values)
    return out
