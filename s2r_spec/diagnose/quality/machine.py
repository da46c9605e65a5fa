"""Which machine of the catalogue the recordings could be of: a fit of a few effects, simulated exactly.

Model: r = J θ + ε, with θ ~ N(0, 1) in the sizes that were simulated, and ε ~ N(0, C). Estimator: the posterior mean of
the few effects that explain most, simulated, and the same again of what is left (Gauss–Newton, nominal derivatives).
"""

from __future__ import annotations

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.quality.comparison import SEEDS, Comparison, affordable
from s2r_spec.diagnose.simulator.axes import Values
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.library import CAUSES


def nearest_machine(bench: Bench, c: Comparison, values: FloatArray) -> Comparison:
    """Return the comparison with the machine that explains recordings best in the nominal one's place.

    The nominal one itself where no machine does better. A machine far from nominal has a scatter of its own.
    """
    _, cj, gram = c.whitening
    effects = np.array([axis.effect for axis, _ in c.sizes])
    best, nominal, theta, chosen = c.misfit(values), c.nominal, np.zeros(len(gram)), np.zeros(0, dtype=int)
    likeliest: Values = {}
    for _ in range(CAUSES if c.sizes else 0):
        toward = cj @ ((values - nominal) / c.floor).ravel()
        if not len(chosen):
            explained = toward * np.linalg.solve(np.eye(len(gram)) + gram, toward)
            most = sorted(set(effects.tolist()), key=lambda name: -float(explained[effects == name].sum()))
            chosen = np.flatnonzero(np.isin(effects, most[:CAUSES]))
        inner = np.eye(len(chosen)) + gram[np.ix_(chosen, chosen)]
        theta[chosen] += np.linalg.solve(inner, toward[chosen])
        machine = _machine(c, theta)
        runs = c.view.simulate(bench, [(machine, seed) for seed in range(SEEDS // 6)], c.tests)
        mean = runs.mean(axis=0)
        left = c.misfit(values - mean + c.nominal) if np.isfinite(mean).all() else np.inf
        if left >= best:
            break
        best, nominal, likeliest = left, mean, machine
    if not likeliest:
        return c
    seeds = affordable(bench, len(c.tests), SEEDS // 6, SEEDS)
    runs = c.view.simulate(bench, [(likeliest, seed) for seed in range(seeds)], c.tests)
    return c.beside(runs) if np.isfinite(runs).all() else c


def _machine(c: Comparison, theta: FloatArray) -> Values:
    """Return the machine of (k,) sizes; what lies on both sides of nominal is summed."""
    places = dict[str, float]()
    for (axis, value), size in zip(c.sizes, theta.tolist(), strict=True):
        places[axis.name] = places.get(axis.name, 0.0) + size * axis.coordinate(value)
    moved = {axis.name: axis for axis, _ in c.sizes if places[axis.name]}.values()
    out: dict[str, dict[str, float]] = {}
    for axis in moved:
        out.setdefault(axis.effect, {}).update(axis.base)
    for axis in moved:
        out[axis.effect][axis.parameter] = axis.value(places[axis.name])
    return out
