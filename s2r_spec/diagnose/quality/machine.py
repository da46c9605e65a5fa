"""Which machine of the catalogue the recordings could be of: a fit of a few effects, simulated exactly.

Model: r = J θ + ε, with θ ~ N(0, 1) in the sizes that were simulated, and ε ~ N(0, C). Estimator: the posterior mean of
the few effects that explain most, simulated, and the same again of what is left (Gauss–Newton, nominal derivatives).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Values
from s2r_spec.diagnose.quality.comparison import SEEDS, Comparison, affordable
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.simulator.library import CAUSES

FloatArray = NDArray[np.float64]


def nearest(
    bench: Bench, c: Comparison, values: FloatArray, executor: Callable[[], Executor] | None = None
) -> Comparison:
    """Return the comparison with the machine that explains recordings best in the nominal one's place.

    The nominal one itself where no machine does better.
    """
    effects = np.array([line.effect for line, _ in c.sizes])
    seeds = range(affordable(bench, CAUSES * len(c.tests), SEEDS // 6, SEEDS))
    best, theta, chosen = c, np.zeros(len(effects)), np.zeros(0, dtype=int)
    for _ in range(CAUSES if c.sizes else 0):
        _, cj, gram = best.whitening
        toward = cj @ best.rest(values).ravel()
        if not len(chosen):
            explained = toward * np.linalg.solve(np.eye(len(gram)) + gram, toward)
            most = sorted(set(effects.tolist()), key=lambda name: -float(explained[effects == name].sum()))
            chosen = np.flatnonzero(np.isin(effects, most[:CAUSES]))
        inner = np.eye(len(chosen)) + gram[np.ix_(chosen, chosen)]
        theta[chosen] += np.linalg.solve(inner, toward[chosen])
        machine = _machine(c, theta)
        runs = c.view.simulate(bench, [(machine, seed) for seed in seeds], c.tests, executor)
        if not np.isfinite(runs).all() or (other := c.beside(runs)).loss(values) >= best.loss(values):
            break
        best = other
    return best


def _machine(c: Comparison, theta: FloatArray) -> Values:
    """Return the machine of (k,) sizes; what lies on both sides of nominal is summed."""
    places = dict[str, float]()
    for (line, value), size in zip(c.sizes, theta.tolist(), strict=True):
        places[line.name] = places.get(line.name, 0.0) + size * line.coordinate(value)
    moved = {line.name: line for line, _ in c.sizes if places[line.name]}.values()
    out: dict[str, dict[str, float]] = {}
    for line in moved:
        out.setdefault(line.effect, {}).update(line.base)
    for line in moved:
        out[line.effect][line.parameter] = line.value(places[line.name])
    return out
