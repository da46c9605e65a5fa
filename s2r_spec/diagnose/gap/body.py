"""Shifts of residuals: which parts of the machine move as their model does not explain, and when.

Data: residuals of the equations of motion of n real rollouts and of m simulated ones at each of their tests; y (n,) is
the difference of their means, or of their root mean squares, in a window of time. Unknown: the shift of y.
Model: y = X β + ε with ε ~ N(0, (1 + 1/m) s² I), where X has a constant and a slope along each axis of the test space.
Test of β = 0 in every window and column: the generalised likelihood ratio in its monotone form,

    F = ‖P_X y‖² / (q (1 + 1/m) s²),   q = rank X.

The variance s² from run to run is that of the simulated rollouts, or that of the rest of the fit if it is larger.
Lengths of windows double from a 32nd of a rollout to the whole. Windows overlap and columns depend on each other, so
the false-discovery rate is controlled under any dependence.

Units: those of the residuals. Source: Wald 1943; Benjamini and Yekutieli 2001, theorem 1.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.attribution.place import Place, Range, cause_first
from s2r_spec.diagnose.gap import LEVEL
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

CELLS = 32
"""Definition: number of the shortest windows in a rollout, a power of two. Doubled, times are twice as fine."""
FEWEST = 4
"""Definition: least number of rollouts in a window that is tested. Doubled, late windows that few
rollouts reach are not tested."""
MOST = 0.9
"""Tolerance: the answer is the shortest window with this part of the largest energy, size² times length. At 1, it is
the window with the largest energy."""
MUCH = 0.4
"""Tolerance: a shift of the mean is preferred to one of the rms if it has this part of its energy. Doubled, fewer
are."""
NUMERICS = 1e-6
"""Tolerance: least scatter of a column, as a part of the largest recorded value of its unit. Doubled, only recordings
without noise change."""


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

    def to_json(self) -> dict[str, Any]:
        """Return the fields."""
        return dict(vars(self))


@dataclass(frozen=True)
class BodyPart:
    """A part of the machine.

    Attributes:
        name: its name in the backend, "FR calf".
        shifts: one for each of its residuals that shifts, largest F first; () if none does.
    """

    name: str
    shifts: tuple[Shift, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the fields."""
        return {"part": self.name, "shifts": [one.to_json() for one in self.shifts]}


@dataclass(frozen=True)
class Body:
    """The shifts of all parts of the machine.

    Attributes:
        parts: largest F first, then those without a shift in the backend's order.
        rollouts: number of real rollouts.
        duration: of a rollout [s].
        asked: number of tests: mean and rms of every column in every window that enough rollouts have.
        level: false-discovery rate.
    """

    parts: tuple[BodyPart, ...]
    rollouts: int
    duration: float
    asked: int
    level: float = LEVEL

    @property
    def shifted(self) -> tuple[BodyPart, ...]:
        """Return the parts with a shift."""
        return tuple(part for part in self.parts if part.shifts)

    def place(self, part: BodyPart, shift: Shift) -> Place:
        """Return the place of a shift."""
        return Place(Range(shift.begin, shift.end, lowest=0.0, highest=self.duration), part.name)

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

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "level": self.level,
            "rollouts": self.rollouts,
            "duration": self.duration,
            "asked": self.asked,
            "parts": [part.to_json() for part in self.parts],
        }


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one rollout.

    Attributes:
        trace: the residuals, with ``meta["parts"]``.
        recorded: the trace that they were computed from.
    """

    trace: Trace
    recorded: Trace


@dataclass(frozen=True)
class _Column:
    """One column of a residual, its kind ("mean" or "rms"), and the part that it belongs to."""

    channel: str
    index: int
    kind: str
    unit: str
    part: str


def shifts(
    tests: FloatArray,
    real: Sequence[Residuals],
    simulated: Sequence[Sequence[Residuals]],
    duration: float,
) -> Body:
    """Return the shifts of all parts.

    Args:
        tests: (n, dim), each axis from −1 to 1.
        real: n residuals.
        simulated: residuals of two or more nominal rollouts for each real one, at the same test.
        duration: of a rollout [s].
    """
    from scipy.stats import false_discovery_control

    columns = _columns([*real, *(one for several in simulated for one in several)])
    own = np.array([_cells(one, columns, duration) for one in real])
    other = np.array([[_cells(one, columns, duration) for one in several] for several in simulated])
    rough = NUMERICS * _largest(real, columns)
    where = windows()
    rows = [_shift(tests, _window(own, *ends), _window(other, *ends), rough) for ends in where]
    mean, size, scatter, f, p = np.stack(rows, axis=1)  # (windows, columns)
    asked = np.isfinite(p)
    q = np.ones(p.shape)
    if asked.any():
        q[asked] = false_discovery_control(p[asked], method="by")
    found: dict[tuple[str, str], tuple[float, Shift]] = {}
    step = duration / CELLS
    # Averaging makes the longest window the most significant one, so the energy decides.
    energy = np.where(q <= LEVEL, np.diff(where) * size**2, 0.0)
    half = len(columns) // 2
    for k in range(half):
        # A mean has a sign, which an rms lacks.
        kind = k if energy[:, k].max() > MUCH * energy[:, k + half].max() else k + half
        if energy[:, kind].max() == 0.0:
            continue
        best = _shortest(energy[:, kind], where)
        column, (first, last) = columns[kind], where[best]
        shift = Shift(
            column.channel, column.index, column.kind, column.unit, float(step * first), float(step * last),
            float(mean[best, kind]), float(size[best, kind]), float(size[best, kind] / scatter[best, kind]),
            float(p[best, kind]), float(q[best, kind]),
        )  # fmt: skip
        key, clear = (column.part, column.channel), float(f[best, kind])
        if key not in found or clear > found[key][0]:
            found[key] = (clear, shift)
    return Body(_ranked(columns, found), len(real), duration, int(asked.sum()))


def windows() -> list[tuple[int, int]]:
    """Return (begin, end) in cells: of one cell, two, four … up to the whole, each beginning half a length later."""
    lengths = [2**n for n in range(CELLS.bit_length())]
    return [
        (begin, begin + length)
        for length in lengths
        for begin in range(0, CELLS - length + 1, max(length // 2, 1))
    ]


def _shortest(energy: FloatArray, where: Sequence[tuple[int, int]]) -> int:
    """Return the shortest window with :data:`MOST` of the largest energy; among equally short ones that with most."""
    able = np.flatnonzero(energy >= MOST * energy.max()).tolist()
    return min(able, key=lambda i: (where[i][1] - where[i][0], -energy[i]))


def _ranked(
    columns: Sequence[_Column], found: Mapping[tuple[str, str], tuple[float, Shift]]
) -> tuple[BodyPart, ...]:
    of: dict[str, list[tuple[float, Shift]]] = {column.part: [] for column in columns}
    for (part, _), one in sorted(found.items(), key=lambda item: -item[1][0]):
        of[part].append(one)
    ranked = sorted(of, key=lambda name: -of[name][0][0] if of[name] else np.inf)
    return tuple(BodyPart(name, tuple(shift for _, shift in of[name])) for name in ranked)


def _columns(every: Sequence[Residuals]) -> list[_Column]:
    """Return the columns that all of the traces have: the means of all, then the root mean squares of all."""
    first = every[0].trace
    found = []
    for name in first.channels:
        width = _width(first, name)
        if all(name in one.trace.channels and _width(one.trace, name) == width for one in every):
            names = named(first, name, width)
            found += [_Column(name, k, "mean", first.units.get(name, ""), names[k]) for k in range(width)]
    return found + [replace(one, kind="rms") for one in found]


def named(trace: Trace, channel: str, width: int) -> list[str]:
    """Return the part of each column; the channel's name if the backend names no parts."""
    declared = trace.meta.get("parts", {})
    names = [str(name) for name in declared.get(channel, ())] if isinstance(declared, Mapping) else []
    return names if len(names) == width else [channel] * width


def _width(trace: Trace, name: str) -> int:
    return 1 if trace[name].ndim == 1 else int(trace[name].shape[1])


def _values(one: Residuals, columns: Sequence[_Column]) -> FloatArray:
    """(samples, columns), squares for a root mean square."""
    of = {name: one.trace[name].reshape(len(one.trace), -1) for name in {c.channel for c in columns}}
    rows = [of[c.channel][:, c.index] for c in columns]
    return np.column_stack([row**2 if c.kind == "rms" else row for c, row in zip(columns, rows, strict=True)])


def _largest(every: Sequence[Residuals], columns: Sequence[_Column]) -> FloatArray:
    """Return (columns,) the largest recorded value in the unit of each, or of the residual itself."""
    units: dict[str, float] = {}
    for one in every:
        for name, values in one.recorded.channels.items():
            unit = one.recorded.units.get(name, "")
            units[unit] = max(units.get(unit, 0.0), float(np.nan_to_num(np.abs(values)).max(initial=0.0)))
    half = columns[: len(columns) // 2]
    # A column that is missing in one trace may have no largest value.
    own = np.max(
        [np.nan_to_num(np.abs(_values(one, half))).max(axis=0, initial=0.0) for one in every], axis=0
    )
    return np.tile([max(units.get(c.unit, 0.0), float(v)) for c, v in zip(half, own, strict=True)], 2)


def _cells(one: Residuals, columns: Sequence[_Column], duration: float) -> FloatArray:
    """(CELLS, columns) means; NaN where the trace has no sample."""
    values = _values(one, columns)
    place = np.floor((one.trace.times - one.recorded.times[0]) / duration * CELLS + 1e-9).astype(int)
    inside = (place >= 0) & (place < CELLS)
    return np.column_stack([averaged(column[inside], place[inside], CELLS) for column in values.T])


def averaged(values: FloatArray, place: NDArray[np.intp], count: int) -> FloatArray:
    """Return (count,) means of (n,) values by their place; NaN where there is none."""
    there = np.isfinite(values)
    counts = np.bincount(place[there], minlength=count)
    sums = np.bincount(place[there], values[there], minlength=count)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _window(cells: FloatArray, begin: int, end: int) -> FloatArray:
    """Return (…, columns) means and root mean squares over cells; NaN where less than half of them are there."""
    part = cells[..., begin:end, :]
    there = np.isfinite(part)
    count = there.sum(axis=-2)
    means = np.where(there, part, 0.0).sum(axis=-2) / np.maximum(count, 1)
    means[..., means.shape[-1] // 2 :] **= 0.5
    return np.where(2 * count >= end - begin, means, np.nan)


def _shift(tests: FloatArray, own: FloatArray, other: FloatArray, rough: FloatArray) -> FloatArray:
    """Return (5, columns) mean, size, scatter of one rollout, F and p in a window; NaN with too few rollouts.

    Args:
        tests: (n, dim).
        own: (n, columns) of the real rollouts.
        other: (n, m, columns) of the simulated ones.
        rough: (columns,) least standard deviation.
    """
    there = np.isfinite(own) & np.isfinite(other).all(axis=1)
    able = there.sum(axis=0) >= FEWEST
    found = np.full((5, own.shape[1]), np.nan)
    # A rollout that lacks one residual still counts for the others.
    for rollouts in np.unique(there[:, able], axis=1).T:
        mine = able & (there == rollouts[:, None]).all(axis=0)
        ratios = _ratios(
            tests[rollouts], own[np.ix_(rollouts, mine)], other[rollouts][:, :, mine], rough[mine]
        )
        found[:, mine] = ratios
    return found


def _ratios(tests: FloatArray, own: FloatArray, other: FloatArray, rough: FloatArray) -> FloatArray:
    """Return the ratios of columns that all rollouts have; arguments as in :func:`_shift`."""
    from scipy.stats import f as fisher

    n, m = other.shape[:2]
    q, _ = np.linalg.qr(_design(tests))
    rank = q.shape[1]
    mean_sim = other.mean(axis=1)
    y = own - mean_sim
    fitted = q @ (q.T @ y)
    within = ((other - mean_sim[:, None]) ** 2).sum(axis=(0, 1)) / (n * (m - 1))
    left = ((y - fitted) ** 2).sum(axis=0) / (n - rank)
    scatter = np.sqrt(np.maximum(within, left / (1 + 1 / m)) + rough**2)
    # Without any scatter nothing moves, either.
    scatter = np.where(scatter > 0, scatter, np.inf)
    f = (fitted**2).sum(axis=0) / rank / (scatter**2 * (1 + 1 / m))
    p = fisher.sf(f, rank, min(n * (m - 1), n - rank))
    return np.array([y.mean(axis=0), np.sqrt((fitted**2).mean(axis=0)), scatter, f, p])


def _design(tests: FloatArray) -> FloatArray:
    """Return X: a constant, and a slope along each axis if there are enough tests."""
    n, dim = tests.shape
    constant = np.ones((n, 1))
    with_slopes = np.column_stack([constant, tests])
    enough = len(np.unique(tests, axis=0)) >= 2 * (1 + dim) and n >= 3 * (1 + dim)
    return with_slopes if enough and np.linalg.matrix_rank(with_slopes) == 1 + dim else constant
