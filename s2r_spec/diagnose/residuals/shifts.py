"""Shifts of residuals: which parts of the machine move as their model does not explain, and when.

Data: residuals of the equations of motion of n real rollouts and of m simulated ones at each of their tests; y (n,) is
the difference of their means, or of their root mean squares, in a window of time. Unknown: the shift of y.
Model: y = X β + ε with ε ~ N(0, (1 + 1/m) s² I), where X has a constant and a slope along each axis of the test space.
Test of β = 0 in every window and column: the generalised likelihood ratio in its monotone form,

    F = ‖P_X y‖² / (q (1 + 1/m) s²),   q = rank X.

The variance s² from run to run is that of the simulated rollouts, or that of the rest of the fit if it is larger.
Lengths of windows double from a 32nd of a rollout to the whole. Windows overlap and columns depend on each other, so
the false-discovery rate is controlled under any dependence.

Units: those of the residuals. Shapes: n rollouts, c columns; an axis of 2c has their means, then their root mean
squares. Source: Wald 1943; Benjamini and Yekutieli 2001, theorem 1.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from s2r_spec.attribution.place import EXPLAINS, Place, ValueRange, cause_first
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_types import Count, Probability
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.gap import FEWEST, LEVEL, ROUNDING
from s2r_spec.diagnose.residuals.cells import CELLS, cell_means, part_names, widths_of
from s2r_spec.trace import Trace

MOST = 0.9
"""Tolerance: the answer is the shortest window with this part of the largest energy, size² times length. At 1, it is
the window with the largest energy."""


@dataclass(frozen=True)
class Shift:
    """The shift of one residual of one part.

    Attributes:
        channel: the residual's name in the backend.
        column: its column.
        kind: "mean" over the window, or "rms" for a shift that changes its sign with the motion.
        unit: of the residual.
        begin: start of the window, from the start of the rollout [s].
        end: end of the window [s].
        mean: mean of the shift over the rollouts.
        size: root mean square of the shift over the rollouts, which is large also if its sign depends on the test.
        sigma: size in standard deviations from run to run.
        p: p-value in this window.
        adjusted: p-value, adjusted for all columns and windows; a discovery if at most the level.
    """

    channel: str
    column: int
    kind: str
    unit: str
    begin: float
    end: float
    mean: float
    size: float
    sigma: float
    p: float
    adjusted: float


@dataclass(frozen=True)
class BodyPart(Shown):
    """A part of the machine.

    Attributes:
        part: the name of the part in the backend.
        shifts: the shifts of its residuals, clearest first; empty if nothing shifts.
    """

    name: str
    shifts: tuple[Shift, ...]

    JSON = "part=name shifts"


@dataclass(frozen=True)
class Body(Shown):
    """The parts of the machine whose motion their model does not explain.

    Attributes:
        parts: the parts, clearest first.
        rollouts: number of compared real rollouts.
        duration: the duration of a rollout [s].
        asked: number of hypothesis tests: columns times two times windows.
        level: false-discovery rate.
    """

    parts: tuple[BodyPart, ...]
    rollouts: Count
    duration: float
    asked: Count
    level: Probability = LEVEL

    JSON = "level rollouts duration asked parts"

    @property
    def shifted(self) -> tuple[BodyPart, ...]:
        """Return the parts with a shift."""
        return tuple(part for part in self.parts if part.shifts)

    def place(self, part: BodyPart, shift: Shift) -> Place:
        """Return the place of a shift."""
        return Place(ValueRange(shift.begin, shift.end, lowest=0.0, highest=self.duration), part.name)

    @property
    def origin(self) -> tuple[BodyPart, Shift] | None:
        """The part to look at first: of the residual with the largest F, the earliest large shift; None for no shift.

        With many rollouts even a small shift has a large F, so the size decides here.
        """
        if not self.shifted:
            return None
        channel = self.shifted[0].shifts[0].channel
        alike = [(part, shift) for part in self.shifted for shift in part.shifts if shift.channel == channel]
        return cause_first(alike, lambda one: self.place(*one), lambda one: one[1].size)[0]


class Residuals(NamedTuple):
    """Residuals of one rollout, with ``meta["parts"]``, and the trace that they were computed from."""

    trace: Trace
    recorded: Trace


_Column = tuple[str, int, str, str]
"""A column of a residual: name of the residual, number, unit, and the part of the machine that it belongs to."""


def shifts(
    tests: FloatArray, real: Sequence[Residuals], simulated: Sequence[Sequence[Residuals]], duration: float
) -> Body:
    """Return the shifts of all parts.

    Args:
        tests: (n, dim), in the unit cube.
        real: n residuals.
        simulated: residuals of two or more nominal rollouts for each real one, at the same test.
        duration: of a rollout [s].
    """
    from scipy.stats import false_discovery_control

    columns = _columns([one.trace for several in (real, *simulated) for one in several])
    own = np.array([_cells(one, columns, duration) for one in real])
    other = np.array([[_cells(one, columns, duration) for one in several] for several in simulated])
    rough = ROUNDING * np.tile(_largest_values(real, columns), 2)
    ends = windows()
    rows = [_window_statistics(tests, _window(own, *at), _window(other, *at), rough) for at in ends]
    mean, size, scatter, f, p = np.stack(rows, axis=1)  # (windows, 2c)
    testable = np.isfinite(p)
    q = np.ones(p.shape)
    if testable.any():
        q[testable] = false_discovery_control(p[testable], method="by")
    lengths = np.diff(ends)[:, 0]
    # Averaging makes the longest window the most significant one, so the energy decides.
    energy = np.where(q <= LEVEL, lengths[:, None] * size**2, 0.0)
    most = energy.max(axis=0)
    significant: list[tuple[float, str, Shift]] = []
    for k, (channel, number, unit, part) in enumerate(columns):
        # A mean has a sign, which an rms lacks, so it is preferred if it has this part of the energy.
        kind = k if most[k] > EXPLAINS * most[k + len(columns)] else k + len(columns)
        if most[kind] == 0.0:
            continue
        able = np.flatnonzero(energy[:, kind] >= MOST * most[kind])
        best = able[np.lexsort((-energy[able, kind], lengths[able]))[0]], kind
        begin, end = (duration / CELLS * cell for cell in ends[best[0]])
        numbers = (mean[best], size[best], size[best] / scatter[best], p[best], q[best])
        named = "mean" if kind == k else "rms"
        significant.append(
            (f[best], part, Shift(channel, number, named, unit, begin, end, *map(float, numbers)))
        )
    # Of several columns of one part, the one with the largest F counts.
    parts: dict[str, dict[str, Shift]] = {}
    for _, part, shift in sorted(significant, key=lambda one: -one[0]):
        parts.setdefault(part, {}).setdefault(shift.channel, shift)
    names = dict.fromkeys([*parts, *(part for *_, part in columns)])
    body = tuple(BodyPart(name, tuple(parts.get(name, {}).values())) for name in names)
    return Body(body, len(real), duration, int(testable.sum()))


def windows() -> list[tuple[int, int]]:
    """Return (begin, end) in cells: of one cell, two, four … up to the whole, each beginning half a length later."""
    lengths = [2**n for n in range(CELLS.bit_length())]
    return [
        (begin, begin + length)
        for length in lengths
        for begin in range(0, CELLS - length + 1, max(length // 2, 1))
    ]


def _columns(traces: Sequence[Trace]) -> list[_Column]:
    first, columns = traces[0], []
    for name, width in widths_of(traces).items():
        names = part_names(first, name, width) or (name,) * width
        columns += [(name, k, first.units.get(name, ""), part) for k, part in enumerate(names)]
    return columns


def _largest_values(every: Sequence[Residuals], columns: Sequence[_Column]) -> FloatArray:
    units: dict[str, float] = {}
    for trace in (trace for one in every for trace in one):
        for name, values in trace.channels.items():
            unit, size = trace.units.get(name, ""), np.abs(values[np.isfinite(values)]).max(initial=0.0)
            units[unit] = max(units.get(unit, 0.0), float(size))
    return np.array([units.get(unit, 0.0) for _, _, unit, _ in columns])


def _cells(one: Residuals, columns: Sequence[_Column], duration: float) -> FloatArray:
    """Return (CELLS, 2c) means of values, then of squares; NaN where the trace has no sample."""
    values = np.column_stack([one.trace[name].reshape(len(one.trace), -1)[:, k] for name, k, *_ in columns])
    place = np.floor((one.trace.times - one.recorded.times[0]) / duration * CELLS + 1e-9).astype(int)
    inside = (place >= 0) & (place < CELLS)
    both = np.hstack([values, values**2])[inside]
    return np.column_stack([cell_means(column, place[inside], CELLS) for column in both.T])


def _window(cells: FloatArray, begin: int, end: int) -> FloatArray:
    """Return (…, 2c) means and root mean squares over cells; NaN where less than half of them are there."""
    part = cells[..., begin:end, :]
    there = np.isfinite(part)
    count = there.sum(axis=-2)
    means = np.where(there, part, 0.0).sum(axis=-2) / np.maximum(count, 1)
    means[..., means.shape[-1] // 2 :] **= 0.5
    return np.where(2 * count >= end - begin, means, np.nan)


def _window_statistics(
    tests: FloatArray, own: FloatArray, other: FloatArray, rough: FloatArray
) -> FloatArray:
    """Return (5, 2c) mean, size, scatter of one rollout, F and p in a window; NaN with too few rollouts.

    There are (n, dim) tests, (n, 2c) the real rollouts' own, (n, m, 2c) other ones of the simulator, and (2c,) a rough
    least standard deviation.
    """
    from scipy.stats import f as fisher

    there = np.isfinite(own) & np.isfinite(other).all(axis=1)
    able = there.sum(axis=0) >= FEWEST
    statistics = np.full((5, own.shape[1]), np.nan)
    # A rollout that lacks one residual still counts for the others.
    for rollouts in np.unique(there[:, able], axis=1).T:
        mine = able & (there == rollouts[:, None]).all(axis=0)
        simulated = other[rollouts][:, :, mine]
        basis, _ = np.linalg.qr(_design(tests[rollouts]))
        (n, m), rank = simulated.shape[:2], basis.shape[1]
        y = own[np.ix_(rollouts, mine)] - simulated.mean(axis=1)
        fitted = basis @ (basis.T @ y)
        within = simulated.var(axis=1).sum(axis=0) * m / (n * (m - 1))
        left = ((y - fitted) ** 2).sum(axis=0) / (n - rank)
        scatter = np.sqrt(np.maximum(within, left / (1 + 1 / m)) + rough[mine] ** 2)
        # Without any scatter nothing moves, either.
        scatter = np.where(scatter > 0, scatter, np.inf)
        f = (fitted**2).sum(axis=0) / rank / (scatter**2 * (1 + 1 / m))
        p = fisher.sf(f, rank, min(n * (m - 1), n - rank))
        statistics[:, mine] = [y.mean(axis=0), np.sqrt((fitted**2).mean(axis=0)), scatter, f, p]
    return statistics


def _design(tests: FloatArray) -> FloatArray:
    """Return X: a constant, and a slope along each axis if there are enough tests."""
    n, dim = tests.shape
    with_slopes = np.column_stack([np.ones(n), tests])
    enough = len(np.unique(tests, axis=0)) >= 2 * (1 + dim) and n >= 3 * (1 + dim)
    return with_slopes if enough and np.linalg.matrix_rank(with_slopes) == 1 + dim else with_slopes[:, :1]
