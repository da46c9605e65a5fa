"""Which machine of the catalogue the recordings could be of: a fit of a few effects, simulated exactly.

Model: r = Σ_k g_k(x_k) + ε, ε ~ N(0, C), with g_k the changes along line k at coordinate x_k, straight between the
values that were simulated. Estimator: one coordinate at a time is put where it leaves least. What several effects do
together, and between the values, is put right by simulating the fitted machine and fitting what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line, Values
from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.simulator.library import CAUSES

FloatArray = NDArray[np.float64]
Chosen = Mapping[int, int]
"""Number of a line → place on its grid."""


@dataclass(frozen=True, eq=False)
class _Curve:
    """A line: from places on a grid to weights of the k simulated changes.

    Attributes:
        line: see there.
        grid: (p,) coordinates over the range that was simulated.
        table: (p, k) weights of the changes that are those of the line there, straight between values.
    """

    line: Line
    grid: FloatArray
    table: FloatArray

    @classmethod
    def of(cls, line: Line, sizes: Sequence[tuple[Line, float]]) -> _Curve:
        """Return the curve of a line."""
        mine = {line.coordinate(value): k for k, (one, value) in enumerate(sizes) if one.name == line.name}
        nodes = sorted([*mine, 0.0])
        grid = np.linspace(nodes[0], nodes[-1], 41)
        table = np.zeros((len(grid), len(sizes)))
        for x, k in mine.items():
            table[:, k] = np.interp(grid, nodes, np.equal(nodes, x).astype(float))
        return cls(line, grid, table)


def nearest(
    bench: Bench, c: Comparison, values: FloatArray, executor: Callable[[], Executor] | None = None
) -> Comparison:
    """Return the comparison with the machine that explains recordings best in the nominal one's place.

    The nominal one itself where no machine does better.
    """
    curves = [_Curve.of(line, c.sizes) for line in {line.name: line for line, _ in c.sizes}.values()]
    best, least, chosen = c, c.misfit(values), dict[int, int]()
    for _ in range(CAUSES):
        chosen = _fitted(curves, best, values, chosen)
        mean = c.view.simulate(bench, [(_machine(curves, chosen), 0)], c.tests, executor)[0]
        other = replace(c, nominal=c.nominal + mean - c.first)
        if not np.isfinite(mean).all() or (left := other.misfit(values)) >= least:
            break
        best, least = other, left
    return best


def _fitted(curves: Sequence[_Curve], now: Comparison, values: FloatArray, chosen: Chosen) -> dict[int, int]:
    """Return line → place of the few lines that explain most, those of the machine of ``now`` in place of its own."""
    _, cj, gram = now.whitening
    toward = cj @ now.rest(values).ravel()
    w = np.sum([np.zeros(len(gram)), *(curves[n].table[place] for n, place in chosen.items())], axis=0)
    toward = toward + gram @ w
    found, w, least = dict[int, int](), np.zeros(len(gram)), 0.0
    for _ in range(4 * CAUSES):
        tried = []
        for n, curve in enumerate(curves):
            taken = {curves[m].line.effect for m in found if m != n}
            if curve.line.effect in taken or len(taken) == CAUSES:
                continue
            own = w - (curve.table[found[n]] if n in found else 0.0) + curve.table
            left = ((own @ gram) * own).sum(axis=1) - 2.0 * own @ toward
            tried.append((float(left.min()), n, int(left.argmin())))
        left, n, place = min(tried, default=(0.0, 0, 0))
        if left >= least - 1e-9 * abs(least):
            break
        w = w - (curves[n].table[found[n]] if n in found else 0.0) + curves[n].table[place]
        least, found[n] = left, place
    return found


def _machine(curves: Sequence[_Curve], chosen: Chosen) -> Values:
    out: dict[str, dict[str, float]] = {}
    for n, place in chosen.items():
        line = curves[n].line
        for effect, values in line.at(line.value(float(curves[n].grid[place]))).items():
            out.setdefault(effect, {}).update(values)
    return out
