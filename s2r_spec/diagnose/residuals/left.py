"""What is left of a machine: what it does in some cell, and the simulator with the posterior means does not.

Data: means over cells (:mod:`.cells`) of n whole rollouts of the machine, y (n, cells), and of the improved simulator
at their tests, x (n, cells). Unknown: where an unknown cause acts. The *surplus* of a cell is its mean difference d in
units of what needs no cause:

    surplus = |d| / ((t² s²/n + LAWS² e² + ALLOWED² a² + NOTHING² v² + w²)^½ (1 + TAIL log columns))

s² is the variance of y − x from rollout to rollout, and t Student's quantile for LEVEL, shared by all cells. e² is the
mean square of what the named effects do, in this cell and over the column. a² is the sum of that of all typical effects
over the column, v² how much the column varies over time, and w² the sum of what the simulator's variants do. A cell is
*material* above 1. A residual of the equations of motion shows where a cause acts. A channel of a closed loop also
shows the reaction, which goes on after the cause. So beside residuals a channel counts by the part EXPLAINS.

A remainder of a residual has the *frequency* with most of the power of the difference: the largest value of the mean of
the periodograms of the tests, under Hann windows and without their means (Welch, *IEEE Transactions on Audio and
Electroacoustics* 15 (1967) 70). A compliance shows at its resonance, a friction at the frequency of the motion.

Units: those of each quantity; a surplus has none.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from s2r_spec.attribution.place import EXPLAINS, Place, ValueRange, cause_first, find_visit
from s2r_spec.backend import HasResiduals, HasVariants
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_values import Ends, Shown
from s2r_spec.base.quantity import signed_quantity
from s2r_spec.diagnose.gap import FEWEST, LEVEL, SHOTS
from s2r_spec.diagnose.residuals.cells import CELLS, Cell, CellColumn, Cells, part_names, path, widths_of
from s2r_spec.diagnose.simulator.axes import EffectAxis, Values
from s2r_spec.diagnose.simulator.bench import (
    Bench,
    Job,
    Test,
    TestRun,
    evenly,
    places_of,
    run_jobs,
    with_seeds,
)
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.runs.seeds import SeedStream
from s2r_spec.space import key_of
from s2r_spec.trace import Trace, thin

LAWS = 0.3
"""Prior: laws are off by this part of what the named effects do in a cell, and next to it."""
ALLOWED = 0.1
"""Prior: a little of everything is this part of every typical effect."""
NOTHING = 0.03
"""Tolerance: nobody models a channel better than to this part of how much it varies."""
TAIL = 0.2
"""Prior: of a machine that is the simulator's in kind, the largest of many columns is 1 + TAIL · log(columns) times
allowed, as with an exponential tail."""
REPORTED = 5
"""Definition: largest remainders that are kept."""
FINEST = 16
"""Budget: fewest samples of a series whose spectrum counts."""


@dataclass(frozen=True)
class Remainder(Shown):
    """A difference between the machine and the improved simulator in one place.

    Attributes:
        quantity: a recorded channel, or a residual of the nominal model.
        column: the column of the channel.
        part: the part of the machine; "" if the quantity belongs to no single part.
        along: channel whose values bound the place; "" for time.
        low: end of the place, in the channel's unit [or s]; -inf where it has no such end.
        high: end of the place; inf where it has no such end.
        size: the value of the machine minus the value of the improved simulator, in the quantity's unit.
        unit: the unit of the quantity.
        along_unit: the unit of the channel, or of time.
        surplus: size divided by the largest size that needs no cause.
        recorded: whether the quantity is a recorded channel.
        times: first and last time [s] at which the channel has these values; None for all the time, or without channel.
        extent: lowest and highest value of the channel; None if it is not known, or without channel.
        frequency: with most of the power of what is left in the column [Hz]; of the first residual alone, else None.
    """

    quantity: str
    column: int
    part: str
    along: str
    low: float
    high: float
    size: float
    unit: str
    along_unit: str
    surplus: float
    recorded: bool = False
    times: Ends | None = None
    extent: Ends | None = None
    frequency: float | None = None

    JSON = "quantity column part along low=begin high=end size unit along_unit surplus recorded times extent frequency"

    @property
    def begin(self) -> float | None:
        """End of the place; None where it has no such end."""
        return self.low if math.isfinite(self.low) else None

    @property
    def end(self) -> float | None:
        """End of the place; None where it has no such end."""
        return self.high if math.isfinite(self.high) else None

    @property
    def material(self) -> bool:
        """Whether it is more than what is allowed for."""
        return self.surplus > 1.0

    @property
    def place(self) -> Place:
        """Where it is: in a window of time, or at values of a channel."""
        if not self.along:
            return Place(ValueRange(self.low, self.high), self.part)
        time = None if self.times is None else ValueRange(*self.times)
        extent = self.extent or (-math.inf, math.inf)
        values = ValueRange(self.low, self.high, self.along_unit, self.along, *extent)
        return Place(time, self.part, values=(values,))

    def __str__(self) -> str:
        """Return it in words."""
        what = signed_quantity(self.size, self.unit)
        what = f"a difference of {what} in {self.quantity}" if self.recorded else f"{what} of {self.quantity}"
        return f"{what} {self.place}"


def remainders(
    bench: Bench,
    axes: Sequence[EffectAxis],
    rollouts: Sequence[TestRun],
    improved: Values,
    seed: int = 0,
    named: Values | None = None,
) -> tuple[Remainder, ...]:
    """Return where most is left beyond what is allowed for, one cell a quantity's column, the cause's place first.

    Nothing where too few rollouts reached their end: no equation here is of a fall. With the ``improved`` effects, the
    likeliest and a little of all others, the simulator should be nearest to the machine. It may be nearer with those
    that are ``named``: what is left of channels is what both leave.
    """
    whole = [(test, trace) for test, trace in rollouts if trace.failure is None]
    if len(whole) < FEWEST:
        return ()
    tests = [dict(key) for key in places_of([test for test, _ in whole])]
    runs = with_seeds(tests, seed, SeedStream.REMAINDER, 2)
    first, again = runs[::2], runs[1::2]
    nominal = [(test, bench.seen(bench.run({}, test, own), test)) for test, own in again]
    nominal = [(test, trace) for test, trace in nominal if trace.failure is None] or nominal
    widths = _quantities([trace for _, trace in nominal])
    few = evenly(len(tests), SHOTS)
    # How much of a channel is a little of everything is an average over the rollout: one test is enough for it.
    once = len(few) // 2
    machines = [improved] if named is None or named == improved else [improved, named]
    variants = list(bench.backend.variants()) if isinstance(bench.backend, HasVariants) else []
    jobs = [Job({}, tuple(first[n] for n in few), name) for name in ("", *variants)]
    jobs += [Job(axis.at(axis.at_typical()), (first[few[once]],)) for axis in axes]
    jobs += [Job(values, (run,)) for values in machines for run in first]

    def counted(before: int) -> Bench:
        tell, of = bench.progress, len(tests) + len(jobs)
        return replace(bench, progress=lambda done, _: tell(before + done, of)) if tell else bench

    paths = run_jobs(counted(0), [Job(improved, (run,)) for run in again], partial(path, widths))
    at = {key_of(test): rows[0] for test, rows in zip(tests, paths, strict=True)}
    cells = Cells.of(bench.backend.duration, widths, at)
    step = float(np.median([np.median(np.diff(trace.times)) for _, trace in whole]))
    read = partial(_means, cells, step)
    rows = iter(run_jobs(counted(len(tests)), jobs, read))
    usual = next(rows)
    other = [changed - usual for changed in islice(rows, len(variants))]
    typical = [changed - usual[[once]] for changed in islice(rows, len(axes))]
    simulated = np.concatenate(list(rows)).reshape(len(machines), len(tests), -1)
    machine = np.array([read(bench, trace, test) for test, trace in whole])
    at_test = [tests.index(dict(test)) for test, _ in whole]
    columns, known = cells.columns(), np.isfinite(machine).any(axis=0)
    each = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of cells into which no rollout reaches
        for own in simulated:
            sizes = _surplus(machine - own[at_test], usual, own[few] - usual, typical, other, columns)
            each.append(_largest_remainders(*sizes, known, columns))
    largest = min(each, key=lambda collected: max((surplus for surplus, *_ in collected), default=0.0))
    traces = [trace for _, trace in whole]
    found = sort_remainders([_remainder(bench, nominal[0], traces, widths, cell) for cell in largest])
    shown = {key_of(test): trace for test, trace in whole}
    pairs = [(tests[n], shown[key_of(tests[n])], first[n][1]) for n in few]
    return tuple(
        _with_frequency(bench, improved, pairs, one) if not n else one for n, one in enumerate(found)
    )


def _remainder(
    bench: Bench,
    nominal: TestRun,
    traces: Sequence[Trace],
    widths: Mapping[str, int],
    left: tuple[float, float, CellColumn, Cell],
) -> Remainder:
    """Return what is left in a cell, with its unit, and when and how far the real rollouts visit it."""
    surplus, size, column, (along, low, high) = left
    name, times, extent, units = column.quantity, None, None, nominal[1].units
    if along:
        time, values = find_visit(traces, along, column.number, low, high)
        times = None if time is None or time.everything else (time.low, time.high)
        extent = (values.lowest, values.highest) if math.isfinite(values.extent) else None
    part = label(bench, nominal, column, widths[name])
    unit, along_unit = units.get(name, ""), units.get(along, "") if along else "s"
    return Remainder(
        name.removeprefix(RESIDUAL), column.number, part, along, low, high, size, unit, along_unit,
        surplus, not column.residual, times, extent,
    )  # fmt: skip


def _with_frequency(
    bench: Bench, improved: Values, pairs: Sequence[tuple[Test, Trace, int]], one: Remainder
) -> Remainder:
    """Return a remainder of a residual with the frequency of what is left, from (test, trace, seed of a run) each."""
    if one.recorded:
        return one
    series, name = [], RESIDUAL + one.quantity
    period = float(np.median([np.median(np.diff(trace.times)) for _, trace, _ in pairs]))
    for test, trace, seed in pairs:
        both = [bench.seen(each, test) for each in (trace, bench.run(improved, test, seed))]
        if not all(name in each.channels for each in both):
            continue
        times = np.arange(0.0, min(each.duration for each in both), period)
        values = [each[name].reshape(len(each), -1)[:, one.column] for each in both]
        real, own = (np.interp(times, t.times - t.times[0], x) for t, x in zip(both, values, strict=True))
        series.append(real - own)
    return replace(one, frequency=peak_frequency(series, period))


def peak_frequency(series: Sequence[FloatArray], period: float) -> float | None:
    """Return the frequency [Hz] with most of the power of series, ``period`` [s] apart each; None without any."""
    known = [one - one.mean() for one in series if one.size >= FINEST and np.isfinite(one).all()]
    if not known:
        return None
    size = 4 * max(one.size for one in known)
    spectra = [np.abs(np.fft.rfft(one * np.hanning(one.size), size)) ** 2 / one.size for one in known]
    power = np.mean(spectra, axis=0)
    return float(np.fft.rfftfreq(size, period)[int(power.argmax())]) if power.any() else None


def _quantities(traces: Sequence[Trace]) -> dict[str, int]:
    columns = {}
    for name, width in widths_of(traces).items():
        values = np.concatenate([trace[name] for trace in traces])
        if np.isfinite(values).all() and not np.isin(values, (0.0, 1.0)).all():
            columns[name] = width
    return columns


def _means(cells: Cells, step: float, bench: Bench, trace: Trace, test: Test) -> FloatArray:
    """Return (cells,) means of a rollout with at most a sample a ``step`` [s]; NaN for one that ended early."""
    row = cells.means(bench.seen(thin(trace, step), test), test)
    return row if trace.failure is None else np.full_like(row, np.nan)


def _surplus(
    apart: FloatArray,
    nominal: FloatArray,
    explained: FloatArray,
    typical: Sequence[FloatArray],
    variants: Sequence[FloatArray],
    columns: Sequence[CellColumn],
) -> tuple[FloatArray, FloatArray]:
    """Return (cells,) the mean difference d, and its surplus; 0 where a cell says nothing.

    Args:
        apart: (n, cells) the machine less the improved simulator at the same tests.
        nominal: (m, cells) the nominal simulator, at few tests.
        explained: (m, cells) what the improved one does beside it, with the same noise.
        typical: (1, cells) of each effect, what a typical amount of it does at one test.
        variants: (m, cells) of each variant of the simulator, what it does otherwise.
        columns: the cells.
    """
    from scipy.stats import t  # here: a rollout needs no scipy

    def squared(changes: Sequence[FloatArray]) -> FloatArray:
        squares = (np.nan_to_num(np.nanmean(change**2, axis=0)) for change in changes)
        return sum(squares, start=np.zeros(apart.shape[1]))

    effects, little, systematic = squared([explained]), squared(typical), squared(variants)
    moved = np.zeros(apart.shape[1], dtype=bool)
    for part in (column.part for column in columns):
        # Windows alone show how much a column varies: of other cells there are many where it does not.
        windows = nominal[:, part][:, :CELLS]
        spread = np.nanmean((windows - np.nanmean(np.nanmean(windows, axis=0))) ** 2, axis=0)
        varies, usual = NOTHING**2 * np.nan_to_num(np.nanmean(spread)), little[part].mean()
        systematic[part] += LAWS**2 * (effects[part] + effects[part].mean()) + ALLOWED**2 * usual + varies
        # What no effect moves, as a reference, is no part of the machine.
        moved[part] = usual > varies
    n, size = np.isfinite(apart).sum(axis=0), np.nanmean(apart, axis=0)
    surely = t.ppf(1.0 - LEVEL / 2.0 / len(n), np.maximum(n - 1, 1))
    scatter = surely * np.nanstd(apart, axis=0, ddof=1) / np.sqrt(n)
    among = sum(bool(moved[column.part.start]) for column in columns)
    allowed = np.hypot(scatter, np.sqrt(systematic)) * (1.0 + TAIL * np.log(max(among, 1)))
    return size, np.where((n >= FEWEST) & moved, np.nan_to_num(np.abs(size) / allowed), 0.0)


def _largest_remainders(
    size: FloatArray, surplus: FloatArray, known: NDArray[np.bool_], columns: Sequence[CellColumn]
) -> list[tuple[float, float, CellColumn, Cell]]:
    """Return the REPORTED columns with the largest surplus: this, the size and the cell; all arguments are (cells,).

    Channels count less only beside residuals that are ``known``, which any rollout has.
    """
    acts = any(column.residual and known[column.part].any() for column in columns)
    candidates = []
    for column in columns:
        own = begin(surplus[column.part] * (EXPLAINS if acts and not column.residual else 1.0))
        k = int(own.argmax())
        if own[k] > 0.0:
            candidates.append((float(own[k]), float(size[column.part][k]), column, column.cells[k]))
    return sorted(candidates, key=lambda one: -one[0])[:REPORTED]


def begin(surplus: FloatArray, windows: int = CELLS) -> FloatArray:
    """Return the surplus of a column, with 0 in windows of time after the first that says (nearly) as much.

    In a closed loop what acts for a time goes on after it. The first of the (cells,) of a column are ``windows`` of
    time.
    """
    out = surplus.copy()
    begun = np.flatnonzero(out[:windows] > max(1.0, EXPLAINS * out.max()))
    if begun.size:
        out[begun[0] + 1 : windows] = 0.0
    return out


def label(bench: Bench, nominal: TestRun, column: CellColumn, width: int) -> str:
    """Return the name of a column of so many: "" of one, else what the backend calls it, or its number."""
    if column.residual and isinstance(bench.backend, HasResiduals):
        test, trace = nominal
        residuals = bench.backend.residuals(trace, bench.matched.to_backend(test))
        names = part_names(residuals, column.quantity.removeprefix(RESIDUAL), width)
    else:
        names = {each.name: each.columns for each in bench.backend.channels}.get(column.quantity, ())
    if width == 1:
        return ""
    return names[column.number] if len(names) == width else f"column {column.number}"


def sort_remainders(remainders: Sequence[Remainder]) -> tuple[Remainder, ...]:
    """Return remainders with the cause's place first.

    Beside a material residual the time of a recorded channel, which also shows the controller's reaction, does not
    count.
    """
    acts = any(each.material and not each.recorded for each in remainders)
    return tuple(
        cause_first(
            remainders,
            lambda one: Place() if acts and one.recorded else one.place,
            lambda one: one.surplus if one.material else 0.0,
        )
    )
