"""What the equations of motion leave of a machine that they do not leave of the improved simulator, and where.

A cause that the catalogue lacks is imitated by its members in everything that is a mean over a rollout; at one
place, in one window of time or above one voltage it is not. So the nominal residuals of all rollouts are regressed
on what every effect would explain (:mod:`s2r_spec.diagnose.equations`), and what that leaves is averaged over cells:
windows of time, and equal parts of what each channel of a residual's width did. The same is done with the simulator
that has the likeliest effects and a little of all others, at the same tests. The difference is held against what is
allowed for: scatter, laws that are off, a little of everything, and other numerics.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import HasResiduals, HasVariants
from s2r_spec.diagnose.asked import pooled
from s2r_spec.diagnose.equations import Motion
from s2r_spec.diagnose.evidence import ALLOWED
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.diagnose.where.body import named
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

WINDOWS = 32
"""Equal parts of a rollout."""
PARTS = 16
"""Parts of what a channel did, with as many samples each."""
FEWEST_SAMPLES = 10
"""In a cell of a rollout, or it says nothing."""
FEWEST_ROLLOUTS = 5
"""That reach into a cell, or it says nothing."""
LEVEL = 0.05
"""Of a false alarm by scatter alone, over all cells."""
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
TESTS = 3
"""At which the simulator's variants run."""
TOLD = 5
"""Largest ones that are kept."""


@dataclass(frozen=True)
class Remainder:
    """What is left in one cell.

    Attributes:
        residual: of which.
        column: of it.
        part: of the machine that the column is of, where the residual is of several; else "".
        along: channel whose values bound the cell; "" for time.
        low: where the cell begins, in the channel's unit [or s]; -inf if nowhere.
        high: where it ends.
        size: mean of what is left, in the residual's unit.
        unit: of the residual.
        along_unit: of the channel, or of time.
        surplus: size in units of what is allowed for.
    """

    residual: str
    column: int
    part: str
    along: str
    low: float
    high: float
    size: float
    unit: str
    along_unit: str
    surplus: float

    @property
    def material(self) -> bool:
        """Whether it is more than what is allowed for."""
        return self.surplus > 1.0

    def __str__(self) -> str:
        """Return it in words."""
        what = f"{self.size:+.3g} {self.unit} of {self.residual}{f' at {self.part}' if self.part else ''}"
        ends = f"{self.low:.3g} and {self.high:.3g} {self.along_unit}".strip()
        if not self.along:
            return f"{what} between {ends}"
        if np.isinf(self.low):
            return f"{what} where {self.along} is below {self.high:.3g} {self.along_unit}".strip()
        if np.isinf(self.high):
            return f"{what} where {self.along} is above {self.low:.3g} {self.along_unit}".strip()
        return f"{what} where {self.along} is between {ends}"

    def to_json(self) -> dict[str, Any]:
        """Return the fields; None for an end that is nowhere."""
        ends = {
            name: value if np.isfinite(value) else None
            for name, value in (("low", self.low), ("high", self.high))
        }
        return dict(vars(self)) | ends


@dataclass(frozen=True)
class Cells:
    """Where residuals are averaged: in windows of time, and between values of the channels of their width.

    Attributes:
        duration: of a rollout [s].
        widths: residual → columns, in the order of the equations' units.
        edges: (channel, column) → rising values between the cells.
    """

    duration: float
    widths: Mapping[str, int]
    edges: Mapping[tuple[str, int], FloatArray]

    @classmethod
    def of(cls, bench: Bench, traces: Sequence[Trace]) -> Cells:
        """Choose from what a machine did."""
        features = bench.features
        assert features is not None
        widths = {name: len(unit) for name, unit in features.residual_units().items()}
        edges = {}
        for block in features.blocks:
            plain = not block.residual and block.minus is None and block.name not in features.flags
            if not plain or block.width not in widths.values():
                continue
            known = [
                trace.channels[block.source].reshape(len(trace), -1)
                for trace in traces
                if block.source in trace.channels
            ]
            for column in range(block.width):
                values = np.concatenate([each[:, column] for each in known]) if known else np.zeros(0)
                values = values[np.isfinite(values)]
                if values.size:
                    parts = np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1)[1:-1])
                    edges[block.source, column] = np.unique(parts)
        return cls(features.duration, widths, edges)

    def places(self) -> list[tuple[str, int, str, float, float]]:
        """Return residual, column, channel ("" for time), and the two ends of every cell, as :meth:`means` has them."""
        out = []
        windows = np.linspace(0.0, self.duration, WINDOWS + 1)
        for name, width in self.widths.items():
            for column in range(width):
                out += [(name, column, "", float(a), float(b)) for a, b in pairwise(windows)]
                for (channel, _), edges in self._beside(width, column):
                    ends = np.concatenate([[-np.inf], edges, [np.inf]])
                    out += [(name, column, channel, float(a), float(b)) for a, b in pairwise(ends)]
        return out

    def columns(self) -> NDArray[np.intp]:
        """Return (cells,) the number of each one's column, of all residuals'."""
        numbers: dict[tuple[str, int], int] = {}
        return np.array([numbers.setdefault(place[:2], len(numbers)) for place in self.places()])

    def means(self, motion: Motion, trace: Trace) -> tuple[FloatArray, FloatArray]:
        """Return (cells,) means of the residuals, and (probes, cells) of what is taken off them; NaN where too few."""
        window = np.clip((motion.times / self.duration * WINDOWS).astype(int), 0, WINDOWS - 1)
        sample = np.clip(
            np.searchsorted(trace.times - trace.times[0], motion.times - 1e-9), 0, len(trace) - 1
        )
        out = []
        for width, rest, taken in zip(self.widths.values(), motion.rest, motion.taken, strict=True):
            for column in range(width):
                both = np.vstack([rest[None, :, column], taken[:, :, column]])
                out.append(_averaged(both, window, WINDOWS))
                for (channel, place), edges in self._beside(width, column):
                    if channel in trace.channels:
                        values = trace.channels[channel].reshape(len(trace), -1)[sample, place]
                        out.append(_averaged(both, np.searchsorted(edges, values), len(edges) + 1))
                    else:
                        out.append(np.full((len(both), len(edges) + 1), np.nan))
        whole = np.hstack(out)
        return whole[0], whole[1:]

    def _beside(self, width: int, column: int) -> list[tuple[tuple[str, int], FloatArray]]:
        widths: dict[str, int] = {}
        for channel, _ in self.edges:
            widths[channel] = widths.get(channel, 0) + 1
        return [
            (key, edges) for key, edges in self.edges.items() if widths[key[0]] == width and key[1] == column
        ]


def _averaged(values: FloatArray, place: NDArray[np.intp], count: int) -> FloatArray:
    """Return (rows, count) means of (rows, n) values by their place."""
    there = np.isfinite(values).all(axis=0)
    counts = np.bincount(place[there], minlength=count)
    sums = np.array([np.bincount(place[there], row[there], minlength=count) for row in values])
    return np.where(counts >= FEWEST_SAMPLES, sums / np.maximum(counts, 1), np.nan)


def summed(cells: Cells, bench: Bench, trace: Trace, test: Test) -> FloatArray:
    """Return one row of a rollout: (cells,), (probes, cells), a regression's (probes,) and (probes, probes) weight.

    NaN where residuals cannot be computed, and of a rollout that ended early: no equation here is of a fall.
    """
    features = bench.features
    assert features is not None
    whole = trace.failure is None
    motion = features.asked(bench.backend).motion(trace, bench.matched.to_backend(test)) if whole else None
    probes, count = len(features.probes), len(cells.places())
    if motion is None:
        return np.full(count + probes * (count + probes + 1), np.nan)
    rest, taken = cells.means(motion, trace)
    coordinates, weight = motion.asked(bench.instruments(test))
    return np.concatenate([rest, taken.ravel(), coordinates, weight.ravel()])


@dataclass(frozen=True)
class _Sums:
    """n rollouts: (n, cells) residuals, (n, probes, cells) what is taken off them, (n, probes) what is asked for."""

    rest: FloatArray
    taken: FloatArray
    each: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, rows: FloatArray, count: int, probes: int) -> _Sums:
        """Take rows of :func:`summed` apart."""
        a, b, c = np.cumsum([count, probes * count, probes]).tolist()
        n = len(rows)
        return cls(
            rows[:, :a],
            rows[:, a:b].reshape(n, probes, count),
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


def remainders(
    bench: Bench,
    rollouts: Sequence[tuple[Test, Trace]],
    improved: Mapping[str, Mapping[str, float]],
    seed: int = 0,
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Remainder, ...]:
    """Return where most is left beyond what is allowed for, one cell a residual's column, largest surplus first.

    Nothing where the backend's residuals do not know its effects, or too few rollouts have all of them.

    Args:
        bench: the simulator.
        rollouts: (test, trace) of the machine.
        improved: effects with which the simulator is nearest to it.
        seed: of the simulated rollouts.
        executor: makes a pool for these; None runs them here.
        progress: is told (done, of).
    """
    features = bench.features
    if features is None or not features.probes:
        return ()
    cells = Cells.of(bench, [trace for _, trace in rollouts])
    places = cells.places()
    read = partial(summed, cells)
    rows = np.array([read(bench, trace, test) for test, trace in rollouts])
    whole = np.isfinite(rows[:, -1])
    if whole.sum() < FEWEST_ROLLOUTS:
        return ()
    kept = [test for (test, _), there in zip(rollouts, whole, strict=True) if there]
    keys = [key_of(test) for test in kept]
    distinct = list(dict.fromkeys(keys))
    runs = tuple((dict(key), rollout_seed(seed, n, 0, Stream.REMAINDER)) for n, key in enumerate(distinct))
    few = tuple(runs[int(n)] for n in np.linspace(0, len(runs) - 1, min(TESTS, len(runs))).round())
    names = list(bench.backend.variants()) if isinstance(bench.backend, HasVariants) else []
    jobs = [Job(improved, (run,)) for run in runs] + [Job({}, few)] + [Job({}, few, name) for name in names]
    found = run_jobs(bench, jobs, executor, progress, read)

    def sums(block: FloatArray) -> _Sums:
        return _Sums.of(block, len(places), len(features.probes))

    machine, simulated = sums(rows[whole]), sums(np.concatenate(found[: len(runs)]))
    plain, *others = (sums(block).left for block in found[len(runs) :])
    own = simulated.left[[distinct.index(key) for key in keys]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of cells into which no rollout reaches
        numerics = [np.nanmean(other - plain, axis=0) for other in others]
        size, surplus = _beyond(machine, own, numerics, cells.columns())
    return _largest(bench, cells, size, surplus, rollouts[int(np.argmax(whole))])


def _beyond(
    machine: _Sums, own: FloatArray, numerics: Sequence[FloatArray], column: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return (cells,) what is left of the machine and not of the simulator, and that in units of what is allowed for.

    Args:
        machine: n rollouts.
        own: (n, cells) what is left of the improved simulator at the same tests.
        numerics: (cells,) what the simulator's variants change of that, each.
        column: (cells,) which of all residuals' columns a cell is of.
    """
    from scipy.stats import t  # here: a rollout needs no scipy

    apart = machine.left - own
    n = np.isfinite(apart).sum(axis=0)
    size = np.nanmean(apart, axis=0)
    scatter = np.nanstd(apart, axis=0, ddof=1) / np.sqrt(n)
    surely = t.ppf(1.0 - LEVEL / 2.0 / len(column), np.maximum(n - 1, 1))
    explained = np.nanmean(machine.explained**2, axis=0)
    typical = np.nanmean(machine.taken**2, axis=0).sum(axis=0)

    def over_column(squares: FloatArray) -> FloatArray:
        counts = np.bincount(column, np.isfinite(squares))
        return np.asarray((np.bincount(column, np.nan_to_num(squares)) / np.maximum(counts, 1))[column])

    # A law that is off is off where ours explains something, and next to it.
    systematic = (
        LAWS**2 * (explained + over_column(explained))
        + ALLOWED**2 * np.fmax(typical, over_column(typical))
        + OWN**2 * np.nanmean(own**2, axis=0)
        + NOTHING**2
        + sum(np.nan_to_num(each) ** 2 for each in numerics)
    )
    moved = over_column(typical) > MOVED**2
    largest = 1.0 + TAIL * np.log(max(len(np.unique(column[moved])), 1))
    surplus = np.abs(size) / np.hypot(surely * scatter, np.sqrt(systematic)) / largest
    return size, np.where((n >= FEWEST_ROLLOUTS) & moved, np.nan_to_num(surplus), 0.0)


def _part(residuals: Trace, residual: str, column: int, width: int) -> str:
    """Return what a column belongs to, or its number; "" where there is but one."""
    part = named(residuals, residual, width)[column]
    return "" if width == 1 else f"column {column}" if part == residual else part


def _largest(
    bench: Bench, cells: Cells, size: FloatArray, surplus: FloatArray, rollout: tuple[Test, Trace]
) -> tuple[Remainder, ...]:
    """Return the cell of the largest surplus of every column, the :data:`TOLD` largest of these."""
    features, backend = bench.features, bench.backend
    assert features is not None
    assert isinstance(backend, HasResiduals)
    test, trace = rollout
    scales = features.residual_units()
    found = backend.residuals(trace, bench.matched.to_backend(test))
    units = dict(trace.units) | dict(found.units)
    out: dict[tuple[str, int], Remainder] = {}
    places = cells.places()
    for k in np.argsort(-surplus, kind="stable"):
        residual, column, along, low, high = places[k]
        if (residual, column) not in out and surplus[k] > 0.0:
            width = len(scales[residual])
            out[residual, column] = Remainder(
                residual,
                column,
                _part(found, residual, column, width),
                along,
                low,
                high,
                float(size[k] * scales[residual][column]),
                units.get(residual, ""),
                units.get(along, "") if along else "s",
                float(surplus[k]),
            )
        if len(out) == TOLD:
            break
    return tuple(out.values())
