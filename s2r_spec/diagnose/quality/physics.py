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
from functools import partial

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line, Values
from s2r_spec.diagnose.quality.comparison import BUDGET, FEWEST, LEAST, Comparison, noise, sampled
from s2r_spec.diagnose.quality.comparison import SEEDS as MANY
from s2r_spec.diagnose.simulate import Bench, Job, run_jobs

FloatArray = NDArray[np.float64]

EFFECTS = 3
"""Definition: effects that a machine has at most."""
LINES, MOST = 3, 18
"""Budget: lines that are tried by simulation, and machines of one effect that are simulated for it at most. Twice as
many find effects that are far from linear in more cases."""
LOOKS = 3
"""Budget: machines of several effects that are simulated; twice as many fit these nearer."""
SEEDS = 2
"""Budget: rollouts a test of each; twice as many halve the variance of its mean."""
PLACES = 41
"""Definition: coordinates of a line that are tried."""
WORTH = 0.02
"""Tolerance: part of the misfit that a further effect must explain; twice as much leaves small ones out."""


@dataclass(frozen=True, eq=False)
class _Curve:
    """A line: from coordinates to weights of the simulated changes."""

    line: Line
    at: FloatArray
    places: tuple[int, ...]

    def weights(self, x: float, k: int) -> FloatArray:
        """Return (k,) weights of the changes that are those of the line at ``x``, straight between values."""
        nodes = np.append(self.at, 0.0)
        order = np.argsort(nodes)
        out = np.zeros(k)
        for place, node in zip(self.places, range(len(self.places)), strict=True):
            unit = (order == node).astype(float)
            out[place] = np.interp(x, nodes[order], unit)
        return out

    def grid(self) -> FloatArray:
        """Return (PLACES,) coordinates over the range that was simulated."""
        return np.linspace(min(self.at.min(), 0.0), max(self.at.max(), 0.0), PLACES)


def _curves(c: Comparison) -> list[_Curve]:
    found: dict[str, list[int]] = {}
    for k, (line, _) in enumerate(c.sizes):
        found.setdefault(line.name, []).append(k)
    return [
        _Curve(
            c.sizes[places[0]][0],
            np.array([c.sizes[k][0].coordinate(c.sizes[k][1]) for k in places]),
            tuple(places),
        )
        for places in found.values()
    ]


def nearest(
    bench: Bench, c: Comparison, values: FloatArray, executor: Callable[[], Executor] | None = None
) -> tuple[Comparison, Values]:
    """Return the comparison with the machine that explains recordings best in the nominal one's place, and its effects.

    The nominal one itself where no machine does better, or a rollout costs too much to try.
    """
    curves = _curves(c)
    looks = int(BUDGET / (c.cost * SEEDS * len(c.tests)))
    if not curves or looks < LOOKS:
        return c, {}
    chosen, least = _exact(bench, c, values, curves, executor, min(looks // 2, MOST))
    if not chosen:
        return c, {}
    for _ in range(LOOKS):
        # What is left of the best machine is fitted with the nominal derivatives, and simulated again.
        mean = _simulated(bench, c, _machine(curves, chosen), executor)
        if mean is None:
            break
        more = _further(curves, replace(c, nominal=mean), values, chosen)
        other = _simulated(bench, c, _machine(curves, more), executor)
        if other is None or (left := replace(c, nominal=other).misfit(values)) >= least:
            break
        chosen, least = more, left
    machine = _machine(curves, chosen)
    return rebased(bench, c, machine, executor), machine


def rebased(
    bench: Bench, c: Comparison, machine: Values, executor: Callable[[], Executor] | None = None
) -> Comparison:
    """Return the comparison with a machine, and its own scatter, in place of the nominal one."""
    seeds = int(np.clip(BUDGET / (c.cost * len(c.tests)), FEWEST, MANY))
    jobs = [Job(machine, tuple((test, seed) for test in c.tests)) for seed in range(seeds + 1)]
    rows = run_jobs(bench, jobs, executor, None, partial(sampled, c.columns, c.times))
    rollouts = np.array(rows).reshape(seeds + 1, *c.nominal.shape)
    if not np.isfinite(rollouts).all():
        return c
    mean, floor, scatter = noise(rollouts[:-1])
    shape = (len(c.effects), len(c.tests), *c.nominal.shape[1:])
    effects = (c.effects.reshape(shape) * (c.floor / floor)).reshape(c.effects.shape)
    made = replace(c, nominal=mean, floor=floor, scatter=scatter, effects=effects)
    return replace(made, usual=max(made.misfit(rollouts[-1]), LEAST))


def _exact(
    bench: Bench,
    c: Comparison,
    values: FloatArray,
    curves: Sequence[_Curve],
    executor: Callable[[], Executor] | None,
    looks: int,
) -> tuple[dict[int, float], float]:
    """Return the line and its coordinate that explain most by themselves, by simulation, and Q.

    The LINES that look best along their curves are tried, at values around the best of these.
    """
    q, toward, gram = c.moments(values)
    tables = [np.array([curve.weights(x, len(toward)) for x in curve.grid()]) for curve in curves]
    left = [q - 2.0 * t @ toward + np.einsum("xi,ij,xj->x", t, gram, t) for t in tables]
    order = sorted(range(len(curves)), key=lambda n: float(left[n].min()))[:LINES]
    best: dict[int, float] = {}
    least, tried = c.misfit(values), 0
    for n in order:
        grid = curves[n].grid()
        x, step = float(grid[left[n].argmin()]), float(np.ptp(grid)) / 8
        mine = np.inf
        for _ in range(3):
            for at in (x - step, x, x + step):
                at = float(np.clip(at, grid[0], grid[-1]))
                if not at or tried >= looks:
                    continue
                tried += 1
                mean = _simulated(bench, c, _machine(curves, {n: at}), executor)
                if mean is None:
                    continue
                found = replace(c, nominal=mean).misfit(values)
                if found < mine:
                    mine, x = found, at
                if found < least:
                    least, best = found, {n: at}
            step /= 2
    return best, least


def _further(
    curves: Sequence[_Curve], now: Comparison, values: FloatArray, chosen: Mapping[int, float]
) -> dict[int, float]:
    """Return line → coordinate with what is left of a machine fitted along all lines, its own included."""
    q, toward, gram = now.moments(values)
    k = len(toward)
    weights = sum((curves[n].weights(x, k) for n, x in chosen.items()), np.zeros(k))
    # The machine that was simulated stands for its own weights; others are tried in their place.
    more = float(2.0 * toward @ weights + weights @ gram @ weights)
    return _fit(curves, q, toward + gram @ weights, gram, more)


def _fit(
    curves: Sequence[_Curve], q: float, toward: FloatArray, gram: FloatArray, more: float
) -> dict[int, float]:
    """Return line → coordinate of the few lines that explain most of a misfit q + more."""
    k = len(toward)
    total = q + more
    tables = [np.array([curve.weights(x, k) for x in curve.grid()]) for curve in curves]

    def best(number: int, others: FloatArray) -> tuple[float, float, FloatArray]:
        all_ = tables[number] + others
        left = total - 2.0 * all_ @ toward + np.einsum("xi,ij,xj->x", all_, gram, all_)
        place = int(left.argmin())
        return float(left[place]), float(curves[number].grid()[place]), tables[number][place]

    chosen: dict[int, tuple[float, FloatArray]] = {}
    least = total
    while len(chosen) < EFFECTS:
        taken = {curves[n].line.effect for n in chosen}
        rest = sum((w for _, w in chosen.values()), np.zeros(k))
        tried = [(*best(n, rest), n) for n, curve in enumerate(curves) if curve.line.effect not in taken]
        if not tried:
            break
        left, x, w, number = min(tried, key=lambda one: one[0])
        if left > least - WORTH * total:
            break
        chosen[number], least = (x, w), left
        for _ in range(3 if len(chosen) > 1 else 0):
            for n in list(chosen):
                rest = sum((w for m, (_, w) in chosen.items() if m != n), np.zeros(k))
                least, x, w = best(n, rest)
                chosen[n] = (x, w)
    return {n: x for n, (x, _) in chosen.items() if x}


def _machine(curves: Sequence[_Curve], chosen: Mapping[int, float]) -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = {}
    for n, x in chosen.items():
        line = curves[n].line
        out.setdefault(line.effect, {}).update(line.at(line.value(x))[line.effect])
    return out


def _simulated(
    bench: Bench, c: Comparison, machine: Values, executor: Callable[[], Executor] | None
) -> FloatArray | None:
    """Return (n, T, c) mean of a machine at the tests; None where it falls."""
    jobs = [Job(machine, tuple((test, seed) for seed in range(SEEDS))) for test in c.tests]
    rows = run_jobs(bench, jobs, executor, None, partial(sampled, c.columns, c.times))
    mean = np.array([values.mean(axis=0).reshape(len(c.times), len(c.columns)) for values in rows])
    return mean if np.isfinite(mean).all() else None
