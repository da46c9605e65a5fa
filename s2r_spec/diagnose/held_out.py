"""What the simulator makes of the held-out tests: nominal, with the named effects, with a little of all others, too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import BACKGROUND, Values
from s2r_spec.diagnose.design import unit_box, weights
from s2r_spec.diagnose.how_far import HowFar, gap, how_far
from s2r_spec.diagnose.parted import Parted
from s2r_spec.diagnose.prepare import Progress, State
from s2r_spec.diagnose.signatures import Curve
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SHOTS = 3
"""Simulated rollouts per held-out test, before and after."""
MACHINES, BANK_MACHINES = 20, 200
"""Random ones with a little of every effect: that many are simulated, or made from the bank."""
REPLICATED = 5
"""Degrees of freedom from which on replicates say how much ρ scatters."""
MOSTLY = 0.9
"""Part of the mean square of what a little of every effect makes of ρ that is no longer everybody's."""
SURELY_LESS = 0.95
"""Part of the random machines whose gap is no more than what a little of every effect makes."""


@dataclass(frozen=True)
class _Shots:
    """ρ of one simulator at the held-out tests.

    Attributes:
        rho: (tests, shots).
        fell: the same shape: whether the rollout ended early.
        at: (rollouts,) which test each real rollout is of.
    """

    rho: FloatArray
    fell: NDArray[np.bool_]
    at: NDArray[np.intp]

    @property
    def mean(self) -> FloatArray:
        """Return (rollouts,) mean ρ at the test of each."""
        return np.asarray(self.rho.mean(axis=1)[self.at])

    @property
    def variance(self) -> FloatArray:
        """Return (rollouts,) variance of ρ from shot to shot at the test of each."""
        return np.asarray(self.rho.var(axis=1, ddof=1)[self.at])

    @property
    def stands(self) -> NDArray[np.bool_]:
        """Return (rollouts,) whether no shot fell at the test of each; all, if some shot fell at every test."""
        falls = self.fell.any(axis=1)
        return np.asarray(np.logical_or(~falls, falls.all())[self.at])


def measured(
    bench: Bench,
    state: State,
    parts: Parted,
    values: Values,
    tuned: Values,
    seed: int,
    executor: Callable[[], Executor] | None,
    tell: Progress,
) -> HowFar | None:
    """Measure the gap at the held-out tests before and after; None where none was held out.

    Args:
        bench: the simulator and the spec.
        state: what the rollouts that were seen gave rise to.
        parts: the real rollouts, seen and held out.
        values: effect → parameter → value of what is named; empty where nothing is.
        tuned: the same with a little of every other effect.
        seed: of the simulations.
        executor: makes a pool for them; None runs them here.
        tell: is told how far that is.
    """
    if not parts.held:
        return None
    tests = [test for test, _ in parts.held]
    real = np.array([bench.rho(trace, test) for test, trace in parts.held])
    patches = [{}, tuned, *([values] if values else [])]
    nominal, with_rest, *named = _shots(bench, tests, patches, seed, executor, tell)
    # What the cause makes unsteady scatters more than the nominal simulator does; and either more at some tests.
    larger = np.maximum(nominal.variance, (named or [with_rest])[0].variance)
    # A fall counts for so much that neither scatter nor a little of everything could be told beside it.
    own = float(np.sqrt(larger)[nominal.stands].mean())
    others = np.array([bench.rho(trace, test) for test, trace in parts.compared])
    # A fall scatters by as much as it counts for: with it in the floor, no fall would be a gap. Nor does a rollout that
    # is in both, after tests changed places, scatter.
    apart = {id(trace) for _, trace in parts.held}
    both = [
        (test, rho)
        for (test, trace), rho in zip(parts.compared, others, strict=True)
        if trace.failure is None and id(trace) not in apart
    ]
    both += [
        (test, rho) for (test, trace), rho in zip(parts.held, real, strict=True) if trace.failure is None
    ]
    stood = [run for run, stands in zip(parts.held, nominal.stands, strict=True) if stands]
    return how_far(
        real,
        nominal.mean,
        named[0].mean if named else None,
        with_rest.mean,
        tests,
        scatter([test for test, _ in both], np.array([rho for _, rho in both]), own),
        _background(state, bench, stood, seed, executor),
        SHOTS,
        bench.spec.unit(bench.requirement),
        _oracle(bench, state, tests, real, nominal.mean),
        seed,
        gap(others - state.nominal_rho, state.smooth.layout.place, seed),
    )


def scatter(tests: Sequence[Test], real: FloatArray, simulated: float) -> float:
    """Return the standard deviation of ρ from run to run: of replicates where there are, else the simulator's.

    The mean of that over the tests: one, at which a motor saturates, may scatter as much as all others together.

    Args:
        tests: n of them.
        real: (n,) ρ of the machine.
        simulated: standard deviation of the simulator's ρ.
    """
    of_test: dict[tuple[tuple[str, float], ...], list[float]] = {}
    for test, rho in zip(tests, real.tolist(), strict=True):
        of_test.setdefault(key_of(test), []).append(rho)
    several = [np.array(mine) for mine in of_test.values() if len(mine) > 1]
    free = sum(len(mine) - 1 for mine in several)
    if free < REPLICATED:
        return simulated
    # The mean |difference| of two normal numbers is 2/√π of their standard deviation.
    apart = [float(np.abs(mine[:, None] - mine).sum()) / len(mine) for mine in several]
    return sum(apart) / free * float(np.sqrt(np.pi)) / 2.0


def _shots(
    bench: Bench,
    tests: Sequence[Test],
    patches: Sequence[Values],
    seed: int,
    executor: Callable[[], Executor] | None,
    tell: Progress,
) -> list[_Shots]:
    """Return what the simulator does with each patch, all with the same random numbers."""
    place = {key: n for n, key in enumerate(dict.fromkeys(key_of(test) for test in tests))}
    runs = tuple(
        (dict(key), rollout_seed(seed, n, shot, Stream.GAP_SIM))
        for key, n in place.items()
        for shot in range(SHOTS)
    )
    rows = run_jobs(
        replace(bench, features=None),
        [Job(patch, runs) for patch in patches],
        executor,
        lambda done, of: tell("held-out tests", done, of),
        read=_rho_and_end,
    )
    at = np.array([place[key_of(test)] for test in tests], dtype=np.intp)
    shape = (len(place), SHOTS)
    return [_Shots(each[:, 0].reshape(shape), each[:, 1].reshape(shape) > 0.0, at) for each in rows]


def _rho_and_end(bench: Bench, trace: Trace, test: Test) -> FloatArray:
    return np.array([bench.rho(trace, test), float(trace.failure is not None)])


def _from_bank(state: State, bench: Bench, tests: Sequence[Test]) -> FloatArray:
    """Return (tests, m) weights with which values at the bank's tests become values at these."""
    space = bench.spec.space
    return weights(unit_box(space, state.signatures.bank.tests), unit_box(space, tests))


def _oracle(
    bench: Bench, state: State, tests: Sequence[Test], real: FloatArray, nominal: FloatArray
) -> float:
    """Return the smallest mean gap that any point of any line reaches at the held-out tests, by the bank."""
    w = _from_bank(state, bench, tests)
    gaps = [
        np.abs(real - nominal - (w @ curve.rho.T).T).mean(axis=1).min()
        for curve in state.signatures.curves
        if not curve.line.base
    ]
    return float(min(gaps))


def _background(
    state: State,
    bench: Bench,
    held: Sequence[tuple[Test, Trace]],
    seed: int,
    executor: Callable[[], Executor] | None,
) -> float:
    """Return the mean gap in ρ that a little of every effect makes, at most, in 19 of 20 random machines.

    Of machines that stand where the real one does: a fall that it does not have makes none of its gap. By the
    simulator where rollouts are cheap: at a test at which a motor saturates a little makes much, and the bank would
    have that at every test next to it.
    """
    dear = state.simulator.dear
    at = _a_little(state, BANK_MACHINES if dear else MACHINES)
    if dear:
        change: FloatArray = _by_bank(state, bench, at, [test for test, _ in held])
    else:
        change = _by_simulator(state, bench, at, held, seed, executor)
    return float(np.quantile(np.ma.filled(np.abs(change).mean(axis=1), 0.0), SURELY_LESS))


def mostly_of_one(curves: Sequence[Curve]) -> str:
    """Return the effect that makes nearly all of what a little of every effect makes of ρ; "" where there is none."""
    own: dict[str, float] = {}
    for curve in curves:
        if not curve.line.base:
            own[curve.line.effect] = own.get(curve.line.effect, 0.0) + float((_slope(curve) ** 2).mean())
    first = max(own, key=lambda effect: own[effect])
    return first if len(own) > 1 and own[first] > MOSTLY * sum(own.values()) else ""


def _a_little(state: State, machines: int) -> FloatArray:
    """Return (machines, K) coordinates of random machines that have a little of every effect."""
    rng = np.random.default_rng(0)
    catalogue = state.view.surrogate.catalogue
    at = np.zeros((machines, len(catalogue.based)))
    for line in np.flatnonzero(~catalogue.based).tolist():
        sides = [side for side, end in ((-1, catalogue.lower[line]), (1, catalogue.upper[line])) if end]
        at[:, line] = rng.choice(sides, machines) * BACKGROUND * np.abs(rng.normal(size=machines))
    return at


def _by_bank(state: State, bench: Bench, at: FloatArray, tests: Sequence[Test]) -> FloatArray:
    """Return (machines, tests) change of ρ, each line straight to the bank's value next to nominal."""
    w = _from_bank(state, bench, tests)
    total = np.zeros((len(at), len(tests)))
    for line, curve in enumerate(state.signatures.curves):
        for side in () if state.view.surrogate.catalogue.based[line] else (-1, 1):
            if any(c * side > 0 for c in curve.coordinates):
                slope = w @ _slope(curve, side)
                total += np.outer(np.where(at[:, line] * side > 0, at[:, line], 0.0), slope)
    return total


def _slope(curve: Curve, side: int = 0) -> FloatArray:
    """Return (bank's tests,) change of ρ a coordinate, to the bank's value next to nominal; of one side, if given."""
    there = [n for n, c in enumerate(curve.coordinates) if side == 0 or c * side > 0]
    near = min(there, key=lambda n: abs(curve.coordinates[n]))
    return np.asarray(curve.rho[near] / curve.coordinates[near])


def _by_simulator(
    state: State,
    bench: Bench,
    at: FloatArray,
    held: Sequence[tuple[Test, Trace]],
    seed: int,
    executor: Callable[[], Executor] | None,
) -> np.ma.MaskedArray:
    """Return (machines, tests) change of ρ; where a machine falls and the real one does not, it is masked."""
    catalogue = state.view.surrogate.catalogue
    fell = {key_of(test) for test, trace in held if trace.failure is not None}
    distinct = list(dict.fromkeys(key_of(test) for test, _ in held))
    runs = tuple((dict(key), rollout_seed(seed, n, SHOTS, Stream.GAP_SIM)) for n, key in enumerate(distinct))
    jobs = [Job({}, runs), *(Job(catalogue.values(each), runs) for each in at)]
    nominal, *others = run_jobs(replace(bench, features=None), jobs, executor, read=_rho_and_end)
    change = np.array([(rows - nominal)[:, 0] for rows in others])
    falls = np.array([rows[:, 1] > 0.0 for rows in others]) & [key not in fell for key in distinct]
    return np.ma.masked_array(change, falls)
