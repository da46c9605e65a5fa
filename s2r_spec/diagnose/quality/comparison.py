"""Recordings beside the simulator at the same tests: the model of the package, its misfit, and the nearest machine.

The nearest machine is a fit of a few effects, simulated exactly. Model: r = J θ + ε, with θ ~ N(0, 1) in the sizes that
were simulated, and ε ~ N(0, C). Estimator: the posterior mean of the few effects that explain most, simulated, and the
same again of what is left (Gauss–Newton, nominal derivatives).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.least_squares import root, solved
from s2r_spec.diagnose.data.space_filling import TESTS
from s2r_spec.diagnose.quality.recordings import as_columns
from s2r_spec.diagnose.simulator.axes import EffectAxis, Values
from s2r_spec.diagnose.simulator.bench import Bench, Job, Test, TestRun, evenly, places_of, run_jobs
from s2r_spec.diagnose.simulator.practice import CAUSES
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import period_of

BUDGET = 20.0
"""Budget: CPU time [s] for the rollouts of a comparison. A simulator that cannot run three tests in it runs these all
the same."""
SEEDS = 24
"""Budget: nominal rollouts a test at most, for their mean and scatter; a sixth of them at least."""
TIMES = 90
"""Definition: instants of a rollout that are compared."""
FLOOR = 0.007
"""Tolerance: part of a column's range that is no discrepancy, whatever the simulator's scatter."""
ROUNDING = 1e-9
"""Tolerance: range of a column below which it does not move, as a part of its largest value, or of one unit."""
CLEAR = 0.15
"""Level: part of the usual misfit by which a discrepancy is there at all, and part of what the best mistake removes by
which another is worse."""


@dataclass(frozen=True)
class ChannelColumn:
    """One column of a channel: its place among them, its name for people ("q, FR hip"), and the channel's unit."""

    channel: str
    place: int
    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class View:
    """What is compared of a rollout: c columns at T times [s] from its begin."""

    columns: tuple[ChannelColumn, ...]
    times: FloatArray

    def of(self, trace: Trace, at: FloatArray) -> FloatArray:
        """Return (T, c) of a trace at times [s] from its begin; NaN before it, and a sample after its end."""
        own = trace.times - trace.times[0]
        out = np.full((len(at), len(self.columns)), np.nan)
        there = (at >= 0.0) & (at < own[-1] + period_of(own))
        for k, column in enumerate(self.columns):
            values = as_columns(trace, column.channel)
            if column.place < values.shape[1]:
                out[there, k] = np.interp(at[there], own, values[:, column.place])
        return out

    def read(self, bench: Bench, trace: Trace, test: Test) -> FloatArray:
        """Return (T · c,) of a simulated rollout."""
        del bench, test
        return self.of(trace, self.times).ravel()

    def simulate(
        self, bench: Bench, machines: Sequence[tuple[Values, int]], tests: Sequence[Test]
    ) -> FloatArray:
        """Return (machines, tests, T, c) of rollouts of machines, each with its seed."""
        jobs = [Job(values, tuple((test, seed) for test in tests)) for values, seed in machines]
        rows = run_jobs(bench, jobs, self.read)
        return np.array(rows).reshape(len(jobs), len(tests), len(self.times), len(self.columns))


@dataclass(frozen=True, eq=False)
class Comparison:
    """n recordings at their tests, and the nominal simulator and its effects there; d = T · c.

    Attributes:
        view: columns and times.
        tests, traces: of each recording.
        nominal: (n, T, c) mean of the nominal simulator.
        floor: (c,) what is no discrepancy, in the units of the columns: the unit of all that follows.
        scatter: (n, s, d) deviations of single nominal rollouts, whose squares sum to their covariance.
        effects, sizes: (k, n, d) changes that the catalogue makes, and (k,) the axis and its value of each.
        usual: Q of a nominal rollout that had no part in mean and scatter; at least that of one floor throughout.
    """

    view: View
    tests: tuple[Test, ...]
    traces: tuple[Trace, ...]
    nominal: FloatArray
    floor: FloatArray
    scatter: FloatArray
    effects: FloatArray
    sizes: tuple[tuple[EffectAxis, float], ...]
    usual: float

    @property
    def columns(self) -> tuple[ChannelColumn, ...]:
        """The c columns, in order."""
        return self.view.columns

    @property
    def clear(self) -> float:
        """A difference of Q that is clear."""
        return CLEAR * self.usual

    @cached_property
    def recorded(self) -> FloatArray:
        """The recordings (n, T, c) as they are."""
        return self.read()[0]

    def read(self, stretch: float = 1.0, late: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return (n, T, c) of the recordings at times stretch · t + late [s], and (T, 1) whether all have samples."""
        values = np.array([self.view.of(trace, stretch * self.view.times + late) for trace in self.traces])
        there = np.isfinite(values).all(axis=(0, 2))[:, None]
        return np.where(there, values, self.nominal), there.astype(float)

    def rest(self, values: FloatArray) -> FloatArray:
        """Return (n, T, c) discrepancies of recordings, in floors."""
        return np.asarray((values - self.nominal) / self.floor)

    @cached_property
    def whitening(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """W (n, s, d) by which C⁻¹ = 1 − WᵀW of a rollout, C⁻¹J (k, n · d), and JᵀC⁻¹J (k, k)."""
        w, j = np.linalg.solve(np.linalg.cholesky(_inner(self.scatter)), self.scatter), self.effects
        own = j.swapaxes(0, 1)
        cj = (own - (own @ w.swapaxes(1, 2)) @ w).swapaxes(0, 1).reshape(len(j), w[:, 0].size)
        return np.asarray(w), cj, np.asarray(j.reshape(cj.shape) @ cj.T)

    @cached_property
    def _root(self) -> FloatArray:
        gram = self.whitening[2]
        return root(np.eye(len(gram)) + gram)

    def products(self, rests: FloatArray, effects: bool = True) -> FloatArray:
        """Return (m, m) products aᵀ(C + JJᵀ)⁻¹b / (n d) of (m, n, T, c) discrepancies; without J if not ``effects``.

        Q of any sum of the discrepancies follows from these.
        """
        w, cj, _ = self.whitening
        flat = rests.reshape(len(rests), len(self.traces), -1)
        whole = flat.reshape(len(flat), -1)
        white = (flat.swapaxes(0, 1) @ w.swapaxes(1, 2)).swapaxes(0, 1).reshape(len(flat), -1)
        squares = whole @ whole.T
        products = squares - white @ white.T
        if effects and len(cj):
            explained = np.linalg.solve(self._root, cj @ whole.T)
            products -= explained.T @ explained
        hidden = whole.shape[1] * np.finfo(float).eps * squares.diagonal()  # of a difference, by rounding
        np.fill_diagonal(products, np.maximum(products.diagonal(), hidden))
        return np.asarray(products / whole.shape[1])

    @cached_property
    def volume(self) -> float:
        """The log |C|, a number of a recording: what a machine that scatters more must explain better."""
        logs = np.linalg.slogdet(_inner(self.scatter))[1].mean() / self.scatter.shape[2]
        return float(logs + 2.0 * np.log(self.floor).mean())

    def beside(self, rollouts: FloatArray) -> Comparison:
        """Return the comparison with the machine of (s, n, T, c) rollouts in the nominal one's place."""
        nominal, floor, scatter, usual = noise(rollouts)
        effects = self.effects.reshape(len(self.effects), *nominal.shape) * (self.floor / floor)
        effects = effects.reshape(self.effects.shape)
        return replace(self, nominal=nominal, floor=floor, scatter=scatter, effects=effects, usual=usual)

    def misfit(self, values: FloatArray, effects: bool = True, there: FloatArray | float = 1.0) -> float:
        """Return Q of recordings (n, T, c), with or without the effects of the catalogue.

        ``there`` has 1 and 0: (T, 1) which instants count, or (n, 1, 1) which recordings.
        """
        return max(float(self.products((self.rest(values) * there)[None], effects)[0, 0]), 0.0)


def affordable(bench: Bench, rollouts: int, least: int, most: int) -> int:
    """Return how many times the budget has so many rollouts, from ``least`` to ``most``."""
    return int(np.clip(BUDGET / (max(float(bench.backend.cost), 1e-4) * rollouts), least, most))


def columns_of(
    bench: Bench, traces: Sequence[Trace], without: Sequence[str] = ()
) -> tuple[ChannelColumn, ...]:
    """Return the columns that every recording has, of numbers throughout, but for some channels'.

    Counts of the controller's software, such as a solver's iterations, are left out: no instrument measures them.
    """
    columns: list[ChannelColumn] = []
    for channel in bench.backend.channels:
        values = [trace.channels.get(channel.name, np.full(1, np.nan)) for trace in traces]
        alike = len({each.shape[1:] for each in values}) == 1
        if channel.name in without or not alike or not all(np.isfinite(each).all() for each in values):
            continue
        if channel.unit == "" and _counts(values):
            continue
        words = channel.columns or [f"column {place + 1}" for place in range(channel.width)]
        names = [channel.name] if channel.width == 1 else [f"{channel.name}, {word}" for word in words]
        columns += [
            ChannelColumn(channel.name, place, name, channel.unit) for place, name in enumerate(names)
        ]
    return tuple(columns)


def _counts(values: Sequence[FloatArray]) -> bool:
    """Whether all samples are whole numbers, and some are beyond 0 and 1, which are flags."""
    whole = all((each == np.round(each)).all() for each in values)
    return whole and any((np.abs(each - 0.5) > 0.5).any() for each in values)


def compare(
    bench: Bench, rollouts: Sequence[TestRun], axes: Sequence[EffectAxis] = (), without: Sequence[str] = ()
) -> Comparison | None:
    """Simulate at tests of the recordings, and return both, ``without`` some channels.

    None where nothing can be compared.
    """
    ran = [(test, trace) for test, trace in rollouts if trace.failure is None and len(trace) > 1]
    ran = [ran[places[0]] for places in places_of([test for test, _ in ran]).values()]
    values = [(axis, axis.value(sign)) for axis in axes for sign in (-1.0, 1.0)]
    sizes = [(axis, value) for axis, value in values if value != axis.nominal]
    most = affordable(bench, SEEDS // 2 + len(sizes), TESTS // 3, TESTS)
    chosen = [ran[place] for place in dict.fromkeys(evenly(len(ran), most))]
    columns = columns_of(bench, [trace for _, trace in chosen], without)
    if not chosen or not columns:
        return None
    room = affordable(bench, len(chosen), 0, SEEDS + len(sizes))
    if room < SEEDS // 2 + len(sizes):
        sizes = [(axis, axis.at_typical()) for axis in axes]
    seeds = int(np.clip(room - len(sizes), SEEDS // 6, SEEDS))
    tests = tuple(test for test, _ in chosen)
    times = np.linspace(0.0, min(trace.duration for _, trace in chosen), TIMES)
    machines: list[tuple[Values, int]] = [({}, seed) for seed in range(seeds)]
    machines += [(axis.at(value), 0) for axis, value in sizes]
    ran_there = View(columns, times).simulate(bench, machines, tests)
    whole = np.asarray(np.isfinite(ran_there[:seeds]).all(axis=(0, 1, 2)))
    if not whole.any():
        return None
    view = View(tuple(column for column, there in zip(columns, whole.tolist(), strict=True) if there), times)
    usual, changed = np.split(ran_there[..., whole], [seeds])
    nominal, floor, scatter, misfit = noise(usual)
    effects = np.nan_to_num((changed - usual[0]) / floor, posinf=0.0, neginf=0.0)
    effects = effects.reshape(len(sizes), len(tests), nominal[0].size)
    moved = (effects**2).mean(axis=(1, 2)) > 1e-6
    kept = tuple(size for size, there in zip(sizes, moved, strict=True) if there)
    traces = tuple(trace for _, trace in chosen)
    return Comparison(view, tests, traces, nominal, floor, scatter, effects[moved], kept, misfit)


def noise(rollouts: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return what (s, n, T, c) nominal rollouts say of a further one.

    A scatter that is as rough as its samples has more directions than there are rollouts to learn them from. What the
    others do not foretell of a rollout is floor, too.

    Returns:
        (n, T, c) mean, (c,) floor, (n, s, T · c) scatter in floors, and Q of a further rollout, at least of one floor.
    """
    mean = rollouts.mean(axis=0)
    reach = np.ptp(mean, axis=(0, 1))
    level = np.maximum(np.abs(mean).max(axis=(0, 1)), 1.0)
    least = FLOOR * np.where(reach > ROUNDING * level, reach, level)
    apart = (rollouts - mean).swapaxes(0, 1)
    _, new = _beside_others(apart / least)
    floor = least * np.sqrt(1.0 + (new**2).mean(axis=(0, 1, 2)))
    own, new = _beside_others(apart / floor)
    return mean, floor, _scatter(apart / floor), float(max((own * new).mean(), ((least / floor) ** 2).mean()))


def _beside_others(apart: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (s, n, T, c) deviations r of each nominal rollout from the mean of the others, and their C⁻¹ r.

    They follow from (n, s, T, c) deviations from the mean of all, in floors.
    """
    n, s = apart.shape[:2]
    flat, one = apart.reshape(n, s, -1), np.eye(s)
    gram, each = flat @ flat.swapaxes(1, 2), np.empty((n, s, s))
    for k in range(s):
        # The others, around their own mean: all that follows is a sum of the s deviations.
        known = _scatter(np.delete(one + one[k] / (s - 1.0), k, axis=0)[None])[0]
        r = one[k] * (s / (s - 1.0))
        inner = np.eye(s - 1) + known @ gram @ known.T
        each[:, k] = r - np.linalg.solve(inner, (known @ (gram @ r)[..., None]))[..., 0] @ known
    left = (each @ flat).reshape(apart.shape)
    return (apart * (s / (s - 1.0))).swapaxes(0, 1), left.swapaxes(0, 1)


def _scatter(apart: FloatArray) -> FloatArray:
    """Return (n, s, d) deviations whose squares sum to the covariance of a rollout around the mean of s others."""
    n, s = apart.shape[:2]
    return np.asarray(apart.reshape(n, s, -1) * np.sqrt((1.0 + 1.0 / s) / (s - 1)))


def _inner(scatter: FloatArray) -> FloatArray:
    inner: FloatArray = np.eye(scatter.shape[1]) + scatter @ scatter.swapaxes(1, 2)
    return inner


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
            explained = toward * solved(np.eye(len(gram)) + gram, toward)
            most = sorted(set(effects.tolist()), key=lambda name: -float(explained[effects == name].sum()))
            chosen = np.flatnonzero(np.isin(effects, most[:CAUSES]))
        inner = np.eye(len(chosen)) + gram[np.ix_(chosen, chosen)]
        theta[chosen] += solved(inner, toward[chosen])
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
