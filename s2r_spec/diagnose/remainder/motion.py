"""What the equations of motion leave of a machine that they do not leave of the improved simulator.

The nominal residuals of all rollouts are regressed on what every effect would explain
(:mod:`s2r_spec.diagnose.equations`), and what that leaves is averaged over cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import HasResiduals
from s2r_spec.diagnose.asked import pooled
from s2r_spec.diagnose.evidence import ALLOWED
from s2r_spec.diagnose.features import Features
from s2r_spec.diagnose.remainder.cells import Cells, beyond, over_column
from s2r_spec.diagnose.simulate import Bench, Test
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

FEWEST_SAMPLES = 10
"""In a cell of a rollout, or it says nothing."""
LAWS = 0.2
"""Laws are off by this part of what they explain in a cell."""
OWN = 0.5
"""And of what the equations leave of the simulator itself there."""
NOTHING = 1.0
"""And by as much as a nominal motion leaves of a residual."""
MOVED = 2.0
"""A column that typical effects together move by less than so many times that says nothing: what a law may be off there
is not known."""
TAIL = 0.5
"""The largest of many columns of a machine that is the simulator's in kind is 1 + TAIL · log(columns) times allowed."""


def cells_of(features: Features, traces: Sequence[Trace]) -> Cells | None:
    """Return where residuals are averaged; None where they do not know the effects."""
    if not features.probes:
        return None
    widths = {name: len(unit) for name, unit in features.residual_units().items()}
    return Cells.of(features, widths, traces, FEWEST_SAMPLES)


def count(cells: Cells, bench: Bench) -> int:
    """Return how many numbers :func:`summed` has."""
    assert bench.features is not None
    probes, places = len(bench.features.probes), len(cells.places())
    return places + probes * (places + probes + 1)


def summed(cells: Cells, bench: Bench, trace: Trace, test: Test) -> FloatArray:
    """Return one row of a rollout: (cells,), (probes, cells), a regression's (probes,) and (probes, probes) weight.

    NaN where residuals cannot be computed.
    """
    features = bench.features
    assert features is not None
    motion = features.asked(bench.backend).motion(trace, bench.matched.to_backend(test))
    if motion is None:
        return np.full(count(cells, bench), np.nan)
    both = [
        np.concatenate([rest[None], taken]) for rest, taken in zip(motion.rest, motion.taken, strict=True)
    ]
    coordinates, weight = motion.asked(bench.instruments(test))
    means = cells.means(both, motion.times, cells.within(trace, motion.times))
    return np.concatenate([means.ravel(), coordinates, weight.ravel()])


@dataclass(frozen=True)
class Sums:
    """n rollouts: (n, cells) residuals, (n, probes, cells) what is taken off them, (n, probes) what is asked for."""

    rest: FloatArray
    taken: FloatArray
    each: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, rows: FloatArray, cells: int, probes: int) -> Sums:
        """Take rows of :func:`summed` apart."""
        a, b, c = np.cumsum([cells, probes * cells, probes]).tolist()
        n = len(rows)
        return cls(
            rows[:, :a],
            rows[:, a:b].reshape(n, probes, cells),
            rows[:, b:c],
            rows[:, c:].reshape(n, probes, probes),
        )

    @property
    def explained(self) -> FloatArray:
        """Return (n, cells) what all rollouts together ask for explains."""
        there = np.isfinite(self.each).all(axis=1)
        asked = pooled(self.each[there], self.weights[there])
        return np.asarray(np.einsum("p,npc->nc", asked, self.taken))

    @property
    def left(self) -> FloatArray:
        """Return (n, cells) what that leaves."""
        return self.rest - self.explained


def left_over(
    machine: Sums, own: FloatArray, numerics: Sequence[FloatArray], column: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return (cells,) what is left of the machine and not of the simulator, and that in units of what is allowed for.

    Args:
        machine: n rollouts.
        own: (n, cells) what is left of the improved simulator at the same tests.
        numerics: (cells,) what the simulator's variants change of that, each.
        column: (cells,) which of all residuals' columns a cell is of.
    """
    explained = np.nanmean(machine.explained**2, axis=0)
    typical = np.nanmean(machine.taken**2, axis=0).sum(axis=0)
    # A law that is off is off where ours explains something, and next to it.
    systematic = (
        LAWS**2 * (explained + over_column(explained, column))
        + ALLOWED**2 * np.fmax(typical, over_column(typical, column))
        + OWN**2 * np.nanmean(own**2, axis=0)
        + NOTHING**2
        + sum(np.nan_to_num(each) ** 2 for each in numerics)
    )
    moved = over_column(typical, column) > MOVED**2
    largest = 1.0 + TAIL * np.log(max(len(np.unique(column[moved])), 1))
    size, surplus = beyond(machine.left - own, systematic, moved)
    return size, surplus / largest


def scales(bench: Bench, cells: Cells) -> FloatArray:
    """Return (cells,) the unit of what is left in each, in the residual's."""
    assert bench.features is not None
    units = bench.features.residual_units()
    return np.array([units[name][column] for name, column, *_ in cells.places()])


def residuals(bench: Bench, test: Test, trace: Trace) -> Trace:
    """Return the nominal residuals of a rollout."""
    assert isinstance(bench.backend, HasResiduals)
    return bench.backend.residuals(trace, bench.matched.to_backend(test))
