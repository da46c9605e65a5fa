"""Recordings beside the simulator at the same tests: the discrepancy that effects leave, before and after undoing.

See the package for the model. Everything here is in units of σ, the simulator's scatter with its floor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line, Values
from s2r_spec.diagnose.quality.recordings import Rollout
from s2r_spec.diagnose.simulate import Bench, Job, Test, evenly, places_of, run_jobs
from s2r_spec.diagnose.simulator.library import POINTS
from s2r_spec.trace import Trace, between

FloatArray = NDArray[np.float64]

BUDGET = 20.0
"""Budget: CPU time [s] for the rollouts that a comparison simulates. Twice as much compares more tests, with more
sizes of every effect; a simulator that cannot run half of TESTS in it runs these all the same."""
TESTS = 6
"""Budget: tests that are compared at most; half of them at least. Twice as many cost twice the time, and find mistakes
that show at few tests."""
SEEDS = 24
"""Budget: nominal rollouts a test at most, for their mean and scatter; a sixth of them at least. Twice as many halve
the variance of the estimate of either."""
FRESH = 3
"""Budget: further nominal rollouts a test, which say what the usual misfit is. Twice as many halve its variance."""
OWN = 10
"""Definition: nominal rollouts of a test from which on its scatter is its own; of fewer it is that of all tests. Twice
as many pool more simulators, whose tests may scatter unlike each other."""
TIMES = 90
"""Definition: instants of a rollout that are compared at most; a third of them at least. Twice as many see delays half
as long."""
NUMBERS = 2000
"""Budget: numbers of a rollout that are compared, about. Twice as many take twice the time with many columns."""
FLOOR = 0.01
"""Tolerance: part of a channel's range that is no discrepancy, whatever the simulator's scatter. Twice as much hides
mistakes that are half as large."""
LEAST = 0.5
"""Tolerance: usual misfit at least, a number; a discrepancy of one floor throughout makes 1. Twice as much hides
mistakes that are 1.4 times as large where the simulator hardly scatters."""
LATEST = 0.1
"""Definition: part of a rollout that a delay is looked for up to; as much at its end is not compared, so that undoing
a delay has samples to read. Twice as much compares less."""


@dataclass(frozen=True)
class Column:
    """One column of a channel, as it is compared.

    Attributes:
        channel: that it is of.
        place: among the channel's columns.
        name: for people ("q, FR hip").
        unit: of the channel.
    """

    channel: str
    place: int
    name: str
    unit: str

    def of(self, trace: Trace) -> FloatArray:
        """Return its samples in a trace."""
        return trace[self.channel].reshape(len(trace), -1)[:, self.place]


@dataclass(frozen=True, eq=False)
class Comparison:
    """n recordings at their tests, and the nominal simulator and its effects there.

    Attributes:
        columns: c of them, that both have.
        tests: of each recording.
        traces: recordings.
        times: (T,) from a recording's begin [s].
        nominal: (n, T, c) mean of the simulator at each test.
        floor: (c,) what is no discrepancy, in the units of the columns: the unit of all that follows.
        scatter: (n, s, d) deviations of single nominal rollouts, whose squares sum to their covariance; d = T · c.
        effects: (k, n, d) changes that the catalogue makes.
        sizes: (k,) the line and its value of each.
        cost: time [s] of one core that a rollout takes, about.
        usual: mean Q of nominal rollouts that had no part in all this.
    """

    columns: tuple[Column, ...]
    tests: tuple[Test, ...]
    traces: tuple[Trace, ...]
    times: FloatArray
    nominal: FloatArray
    floor: FloatArray
    scatter: FloatArray
    effects: FloatArray
    sizes: tuple[tuple[Line, float], ...]
    cost: float
    usual: float = 1.0

    @cached_property
    def recorded(self) -> FloatArray:
        """Return (n, T, c) of the recordings as they are."""
        return self.read()

    def read(self, stretch: float = 1.0, late: float = 0.0) -> FloatArray:
        """Return (n, T, c) of the recordings, read at other times: t → stretch · t + late [s].

        Before the first sample a channel is what it was in the first.
        """
        at = stretch * self.times + late
        rows = [
            [np.interp(at, trace.times - trace.times[0], column.of(trace)) for column in self.columns]
            for trace in self.traces
        ]
        return np.array(rows).transpose(0, 2, 1)

    def rest(self, values: FloatArray) -> FloatArray:
        """Return (n, T, c) discrepancies of recordings, in floors."""
        return np.asarray((values - self.nominal) / self.floor)

    @cached_property
    def _whitening(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (n, s, d) W by which C⁻¹ = 1 − WᵀW of a rollout, (k, n · d) C⁻¹J, and (k, k) JᵀC⁻¹J."""
        w, j = np.linalg.solve(np.linalg.cholesky(_inner(self.scatter)), self.scatter), self.effects
        cj = j - np.einsum("nsd,nsk->knd", w, np.einsum("nsd,knd->nsk", w, j))
        return np.asarray(w), cj.reshape(len(j), -1), np.einsum("knd,lnd->kl", j, cj)

    @cached_property
    def _root(self) -> FloatArray:
        gram = self._whitening[2]
        return np.asarray(np.linalg.cholesky(np.eye(len(gram)) + gram))

    def moments(
        self, values: FloatArray, there: FloatArray | float = 1.0
    ) -> tuple[float, FloatArray, FloatArray]:
        """Return rᵀC⁻¹r of recordings, (k,) JᵀC⁻¹r and (k, k) JᵀC⁻¹J: all that a fit of effects needs."""
        r = (self.rest(values) * there).reshape(len(self.traces), -1)
        w, cj, gram = self._whitening
        q = float(np.vdot(r, r) - (np.matmul(w, r[:, :, None]) ** 2).sum())
        return q, cj @ r.ravel(), gram

    def misfit(self, values: FloatArray, effects: bool = True, there: FloatArray | float = 1.0) -> float:
        """Return Q of recordings (n, T, c), a number of it.

        Args:
            values: recordings.
            effects: whether the catalogue may explain anything.
            there: of 1 and 0, (T, 1) which instants count, or (n, 1, 1) which recordings.
        """
        q, toward, _ = self.moments(values, there)
        if effects and len(toward):
            q -= float((np.linalg.solve(self._root, toward) ** 2).sum())
        return max(q, 0.0) / values.size

    @cached_property
    def volume(self) -> float:
        """Return log |C|, a number of a recording: what a machine that scatters more must explain better."""
        logs = np.linalg.slogdet(_inner(self.scatter))[1].mean() / self.scatter.shape[2]
        return float(logs + 2.0 * np.log(self.floor).mean())

    def elsewhere(self, nominal: FloatArray, scatter: FloatArray, which: NDArray[np.bool_]) -> Comparison:
        """Return the comparison of some recordings (n,) with other means (n, T, c) and scatters (n, s, T · c)."""
        more = max(self.scatter.shape[1], scatter.shape[1])
        own, other = (
            np.pad(each, ((0, 0), (0, more - each.shape[1]), (0, 0))) for each in (self.scatter, scatter)
        )
        mean = np.where(which[:, None, None], nominal, self.nominal)
        return replace(self, nominal=mean, scatter=np.where(which[:, None, None], other, own))

    def affordable(self, tests: int) -> int:
        """Return how many rollouts of each of so many tests the budget has."""
        return int(np.clip(BUDGET / (self.cost * tests), SEEDS // 6, SEEDS))

    def simulated(
        self,
        bench: Bench,
        machine: Values,
        tests: Sequence[Test],
        seeds: int,
        executor: Callable[[], Executor] | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> FloatArray:
        """Return (tests, seeds, T, c) of a machine's rollouts; NaN after one ended early."""
        jobs = [Job(machine, tuple((test, seed) for seed in range(seeds))) for test in tests]
        rows = run_jobs(bench, jobs, executor, progress, partial(sampled, self.columns, self.times))
        return np.array(rows).reshape(len(tests), seeds, len(self.times), len(self.columns))


def columns_of(bench: Bench, traces: Sequence[Trace], without: Sequence[str] = ()) -> tuple[Column, ...]:
    """Return the columns that every recording has, of numbers throughout, but for some."""
    found: list[Column] = []
    for channel in bench.backend.channels:
        values = [trace.channels.get(channel.name, np.full(1, np.nan)) for trace in traces]
        alike = len({each.shape[1:] for each in values}) == 1
        if channel.name in without or not alike or not all(np.isfinite(each).all() for each in values):
            continue
        words = channel.columns or [f"column {place + 1}" for place in range(channel.width)]
        names = [channel.name] if channel.width == 1 else [f"{channel.name}, {word}" for word in words]
        found += [Column(channel.name, place, name, channel.unit) for place, name in enumerate(names)]
    return tuple(found)


def sampled(
    columns: Sequence[Column], times: FloatArray, bench: Bench, trace: Trace, test: Test
) -> FloatArray:
    """Return (T · c,) of a rollout; NaN after it ended."""
    del bench, test
    own = trace.times - trace.times[0]
    out = np.full((len(times), len(columns)), np.nan)
    there = times <= own[-1] + 1e-9
    for k, column in enumerate(columns):
        if column.channel in trace.channels and column.place < trace[column.channel][:1].size:
            out[there, k] = between(times[there], own, column.of(trace))
    return out.ravel()


def compare(
    bench: Bench,
    rollouts: Sequence[Rollout],
    lines: Sequence[Line] = (),
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
    without: Sequence[str] = (),
) -> Comparison | None:
    """Simulate at tests of the recordings, and return both; None where nothing can be compared.

    Args:
        bench: the simulator.
        rollouts: the machine's.
        lines: of the catalogue.
        executor: makes a pool.
        progress: called with (done, of).
        without: channels that are not compared.
    """
    ran = [(test, trace) for test, trace in rollouts if trace.failure is None and len(trace) > 1]
    ran = [ran[places[0]] for places in places_of([test for test, _ in ran]).values()]
    cost = max(float(bench.backend.cost), 1e-4)
    sizes = [(line, line.value(x)) for line in lines for x in line.coordinates(POINTS)]
    most = int(np.clip(BUDGET / (cost * (OWN + len(sizes))), TESTS // 2, TESTS))
    chosen = [ran[place] for place in dict.fromkeys(evenly(len(ran), most))]
    columns = columns_of(bench, [trace for _, trace in chosen], without)
    if not chosen or not columns:
        return None
    room = BUDGET / (cost * len(chosen))
    if room < OWN + len(sizes):
        sizes = [(line, line.at_typical()) for line in lines]
    seeds = int(np.clip(room - len(sizes), SEEDS // 6, SEEDS))
    count = int(np.clip(NUMBERS / len(columns), TIMES // 3, TIMES))
    times = np.linspace(0.0, (1.0 - LATEST) * min(trace.duration for _, trace in chosen), count)
    tests = [test for test, _ in chosen]
    jobs = [Job({}, tuple((test, seed) for test in tests)) for seed in range(seeds + FRESH)]
    jobs += [Job(line.at(value), tuple((test, 0) for test in tests)) for line, value in sizes]
    rows = run_jobs(bench, jobs, executor, progress, partial(sampled, columns, times))
    values = np.array(rows).reshape(len(jobs), len(tests), len(times), len(columns))
    whole = np.asarray(np.isfinite(values[: seeds + FRESH]).all(axis=(0, 1, 2)))
    if not whole.any():
        return None
    columns = tuple(column for column, there in zip(columns, whole.tolist(), strict=True) if there)
    usual, fresh, changed = np.split(values[..., whole], [seeds, seeds + FRESH])
    nominal, floor, scatter = noise(usual)
    effects = np.nan_to_num((changed - usual[0]) / floor, posinf=0.0, neginf=0.0).reshape(
        len(sizes), len(tests), -1
    )
    moved = (effects**2).mean(axis=(1, 2)) > 1e-6
    made = Comparison(
        columns,
        tuple(tests),
        tuple(trace for _, trace in chosen),
        times,
        nominal,
        floor,
        scatter,
        effects[moved],
        tuple(size for size, there in zip(sizes, moved, strict=True) if there),
        cost,
    )
    return replace(made, usual=max(float(np.mean([made.misfit(each) for each in fresh])), LEAST))


def noise(rollouts: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (n, T, c) mean, (c,) floor and (n, s, T · c) scatter of (s, n, T, c) rollouts of one machine."""
    mean = rollouts.mean(axis=0)
    reach = np.ptp(mean, axis=(0, 1))
    floor = FLOOR * np.where(reach > 0.0, reach, np.maximum(np.abs(mean).max(axis=(0, 1)), 1.0))
    apart = (rollouts - mean).transpose(1, 0, 2, 3)
    floor = floor * np.sqrt(1.0 + _beyond(apart / floor))
    return mean, floor, scatter_of(apart / floor)


def scatter_of(apart: FloatArray) -> FloatArray:
    """Return (n, s', T · c) deviations whose squares sum to the covariance of a rollout around the mean of s others.

    Args:
        apart: (n, s, T, c) of s nominal rollouts a test from their mean.
    """
    n, s = apart.shape[:2]
    scatter = apart.reshape(n, s, -1) * np.sqrt((1.0 + 1.0 / s) / (s - 1))
    if s >= OWN:
        return np.asarray(scatter)
    pooled = scatter.reshape(1, n * s, -1) / np.sqrt(n)
    return np.asarray(np.broadcast_to(pooled, (n, *pooled.shape[1:])))


def _inner(scatter: FloatArray) -> FloatArray:
    """Return (n, s, s) 1 + DDᵀ, which has the determinant of C."""
    inner: FloatArray = np.eye(scatter.shape[1]) + np.einsum("nsd,ntd->nst", scatter, scatter)
    return inner


def _beyond(apart: FloatArray) -> FloatArray:
    """Return (c,) mean square of what the other half of the rollouts does not foretell of each, in floors.

    A scatter that is as rough as its samples has more directions than there are rollouts to learn them from.
    """
    n, s, _, c = apart.shape
    known, new = apart[:, ::2], apart[:, 1::2]
    known = scatter_of(known - known.mean(axis=1, keepdims=True))
    flat = new.reshape(n, new.shape[1], -1)
    taken = np.linalg.solve(_inner(known), np.einsum("nsd,nvd->nsv", known, flat))
    left = flat - np.einsum("nsd,nsv->nvd", known, taken)
    return np.asarray((left.reshape(-1, c) ** 2).mean(axis=0) * ((s - 1) / s))
