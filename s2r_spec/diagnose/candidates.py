"""Sets of effects that may explain the tests, each at runs of the simulator of its own.

Where five or more tests of the specification were run, the posterior over sets comes from predictions of left-out tests
(:mod:`.inference.prediction`). A set is proposed from the library: every parameter alone over its whole range, then
further ones beside the sets that predict best. It counts only at its own estimate, where the simulator has run. There a
sum of responses has no error, and the scatter is that of these runs.

Units: sizes in typical sizes. Shapes: K parameters; of each test m observables, of which n are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.backend import Backend
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LARGEST
from s2r_spec.diagnose.inference.instruments import instrument_variance, white_noise
from s2r_spec.diagnose.inference.model_search import ModelPosterior, Set
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prediction import Candidate, fitted, weighted
from s2r_spec.diagnose.inference.prior import BACKGROUND, SLAB, UNNAMED, SizePrior
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import simulated_rows
from s2r_spec.diagnose.simulator.response import ResponseLibrary, replicates
from s2r_spec.diagnose.simulator.runs import SEED
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory

FEWEST = 5
"""Level: tests from which on predictions decide which effects there are."""
ALONE, BESIDE, LARGEST_SET = 6, 3, 4
"""Budget: single parameters, and further ones beside each of the two best sets, at which the simulator runs; causes of
a set."""
GRID = 17
"""Budget: sizes at which a proposal compares the library with the tests, beside those of the library."""

Simulate = Callable[[FloatArray], "list[FloatArray]"]
"""Returns (R, m) observables of the simulator's runs of every test at (K,) sizes."""


@dataclass(frozen=True)
class Predicted:
    """The posterior by predictions, and how much the most probable set leaves.

    Attributes:
        posterior: over the candidates' sets.
        candidates: of all sets at which the simulator ran.
        shown: part of the observables in which the nominal simulator is wrong by more than scatter and background.
        left: part of the misfit of these observables that the most probable set leaves.
    """

    posterior: ModelPosterior
    candidates: Mapping[Set, Candidate]
    shown: float
    left: float


@dataclass(frozen=True)
class TestRuns:
    """The real tests beside the simulator.

    Attributes:
        observations: of every test, without the errors of sums of responses.
        machine: (n,) variance of the mean of a test's real runs.
        scatter: (n,) variance of a run of the nominal simulator.
        runs: number of real runs of every test.
    """

    observations: tuple[Observation, ...]
    machine: tuple[FloatArray, ...]
    scatter: tuple[FloatArray, ...]
    runs: tuple[int, ...]

    @classmethod
    def of(
        cls,
        backend: Backend,
        library: ResponseLibrary,
        tests: Mapping[Experiment, Sequence[Trace]],
    ) -> TestRuns | None:
        """Return the tests of experiment → real runs, with residuals; None where too few have something to show."""
        every = []
        for experiment, traces in tests.items():
            response = library.response(experiment)
            vectors = [response.observables.vector(trace) for trace in traces]
            one = Observation.of(response, vectors, library.dependence)
            vectors = [each for each in vectors if np.isfinite(each[response.bins]).all()] or vectors
            if one.parts:
                nominal = experiment.with_residuals(experiment.run(backend, SEED), backend)
                real, simulated = (white_noise(response.observables, each) for each in (traces, [nominal]))
                beyond = {name: np.maximum(own - simulated[name], 0.0) for name, own in real.items()}
                extra = instrument_variance(
                    response.observables, response.nominal, beyond, max(map(len, traces))
                )
                every.append((one, np.array(vectors)[:, one.kept], extra[one.kept]))
        if len(every) < FEWEST:
            return None
        ratios = _replicate_ratios(every)
        observations, machine, scatter = [], [], []
        for one, vectors, extra in every:
            own = one.response.scatter[one.kept] ** 2
            variance = own + extra
            for name, places in one.parts:
                variance[places] *= ratios[name]
            plain = replace(one, law=0.0, form=np.zeros_like(one.form), spread=np.zeros_like(one.spread))
            observations.append(plain)
            scatter.append(own)
            machine.append(variance / len(vectors) + (one.variants**2).sum(axis=0) + 1e-12)
        return cls(
            tuple(observations),
            tuple(machine),
            tuple(scatter),
            tuple(len(vectors) for _, vectors, _ in every),
        )

    def near(self, theta: FloatArray, rows: Sequence[FloatArray]) -> list[Observation]:
        """Return the observations, corrected by (R, m) runs of every test at (K,) sizes."""
        found = []
        for one, machine, scatter, real, own in zip(
            self.observations, self.machine, self.scatter, self.runs, rows, strict=True
        ):
            correction = own.mean(axis=0) - one.response.reference
            correction[one.kept] -= one.moved(theta)
            beyond = np.zeros_like(scatter)
            if len(own) > 1:
                beyond = np.nan_to_num(own[:, one.kept].var(axis=0, ddof=1))
                for _, places in one.parts:  # two runs say little about a single observable
                    beyond[places] = 0.5 * (beyond[places] + beyond[places].mean())
                beyond = np.maximum(beyond - scatter, 0.0)
            noise = machine + beyond / real + (scatter + beyond) / len(own)
            found.append(replace(one.corrected(correction, theta), noise=noise))
        return found


def _replicate_ratios(
    every: Sequence[tuple[Observation, FloatArray, FloatArray]],
) -> dict[tuple[str, str], float]:
    """Return group → f_g, by which repeated real runs scatter more than simulated ones; at least 1."""
    total: dict[tuple[str, str], float] = {}
    free: dict[tuple[str, str], int] = {}
    for one, vectors, extra in every:
        for name, places in one.parts:
            total.setdefault(name, DEGREES)
            if len(vectors) > 1:
                variance = one.response.scatter[one.kept][places] ** 2 + extra[places] + 1e-12
                ratio = vectors[:, places].var(axis=0, ddof=1) / variance
                if np.isfinite(ratio).any():
                    total[name] += (len(vectors) - 1) * float(np.nanmean(ratio))
                    free[name] = free.get(name, 0) + len(vectors) - 1
    return {name: max(value / (DEGREES + free.get(name, 0)), 1.0) for name, value in total.items()}


def _background(one: Observation) -> FloatArray:
    """Return (n,) the variance by σ_bg of every parameter."""
    each = [(curve.at(-BACKGROUND) ** 2 + curve.at(BACKGROUND) ** 2) / 2.0 for curve in one.curves]
    alone = one.dependence.base < 0
    return np.asarray(sum(own for own, counts in zip(each, alone, strict=True) if counts))


def predicted(
    backend: Backend,
    library: ResponseLibrary,
    tests: Mapping[Experiment, Sequence[Trace]],
    prior: SizePrior,
    executor: ExecutorFactory | None = None,
    proposed: Sequence[tuple[Set, FloatArray]] = (),
) -> Predicted | None:
    """Return the posterior by predictions of left-out tests; None where there are fewer than :data:`FEWEST`.

    Args:
        backend: the nominal simulator.
        library: its responses.
        tests: of the specification → real runs, with residuals.
        prior: of the sizes.
        executor: of the simulations.
        proposed: further sets with (K,) their sizes.
    """
    data = TestRuns.of(backend, library, tests)
    if data is None:
        return None
    responses = [one.response for one in data.observations]

    def simulate(theta: FloatArray) -> list[FloatArray]:
        return simulated_rows(backend, responses, library.values(theta), executor)

    search = _Search(data, prior, simulate)
    search.run(proposed)
    posterior = weighted(search.found, prior)
    shown, left = _left(data, search.found[()], search.found[posterior.sets[0]])
    return Predicted(posterior, search.found, shown, left)


def _left(data: TestRuns, none: Candidate, best: Candidate) -> tuple[float, float]:
    """Return the part of the observables in which a misfit shows, and the part of it that a candidate leaves."""
    names = [name for one in data.observations for name, _ in one.parts]
    size = np.concatenate([one.effective for one in data.observations])
    each = {name: np.array([own == name for own in names]) for name in dict.fromkeys(names)}
    before, after = ([float(one.energy[own].mean()) for own in each.values()] for one in (none, best))
    number = np.array([size[own].sum() for own in each.values()])
    excess, rest = (np.maximum(np.array(x) - 1.0, 0.0) for x in (before, after))
    weight = number * excess / np.maximum(before, 1.0)
    left = float((weight * rest / np.maximum(excess, 1e-9)).sum() / max(weight.sum(), 1e-9))
    return float(weight.sum() / number.sum()), left if weight.sum() > 0.0 else 0.0


class _Search:
    """The candidates so far. They grow."""

    def __init__(self, data: TestRuns, prior: SizePrior, simulate: Simulate) -> None:
        self.data, self.prior, self.simulate = data, prior, simulate
        self.background = [_background(one) for one in data.observations]
        self.found: dict[Set, Candidate] = {}
        self.near: dict[Set, list[Observation]] = {}
        self.grids = [_grid(data, prior, k) for k in range(prior.low.size)]
        self.tables = {
            k: [np.array([one.curves[k].at(float(x)) for x in self.grids[k]]) for one in data.observations]
            for k in prior.causes.tolist()
        }

    def run(self, proposed: Sequence[tuple[Set, FloatArray]]) -> None:
        """Try the empty set, single parameters, proposed sets, and further parameters beside the best ones."""
        self.try_set((), np.zeros(self.prior.low.size))
        for k, theta in self.screened(())[:ALONE]:
            self.try_set((k,), theta)
        for members, theta in proposed:
            self.try_set(members, theta)
        for size in range(1, LARGEST_SET):
            best = [members for members in self.ranked() if len(members) == size][:2]
            before = self.score(self.ranked()[0])
            for members in best:
                self.try_set(members, self.found[members].theta, again=True)
                for k, theta in self.screened(members)[:BESIDE]:
                    self.try_set(tuple(sorted((*members, k))), theta)
            if self.score(self.ranked()[0]) <= before and len(self.ranked()[0]) < size:
                break
        self.try_set((), self.found[()].theta, again=True)
        # A set and the ones without each of its causes are compared at runs near the same sizes.
        best = self.ranked()[0]
        for k in best:
            fewer = tuple(x for x in best if x != k)
            theta = self.found[best].theta.copy()
            theta[k] = np.clip(theta[k], -UNNAMED, UNNAMED)
            self.try_set(fewer, theta, again=True)

    def score(self, members: Set) -> float:
        return float(self.found[members].score.sum())

    def ranked(self) -> list[Set]:
        return sorted(self.found, key=lambda members: -self.score(members))

    def try_set(self, members: Set, theta: FloatArray, again: bool = False) -> None:
        """Run the simulator at (K,) sizes and fit the set there; of two fits the one that predicts better stays."""
        if members in self.found and not again:
            return
        theta = np.clip(theta, self.prior.low, self.prior.high)
        near = self.data.near(theta, self.simulate(theta))
        new = fitted(near, self.background, theta, self.prior, members)
        if members not in self.found or new.score.sum() > self.found[members].score.sum():
            self.found[members], self.near[members] = new, near

    def screened(self, members: Set) -> list[tuple[int, FloatArray]]:
        """Return a further parameter and (K,) sizes with it, the nearest to the tests first."""
        base = self.found[members].theta
        keep = np.isin(np.arange(base.size), members) | (self.prior.probability == 0.0)
        theta, near = np.where(keep, base, 0.0), self.near[members]
        residuals = [one.residual(theta) for one in near]
        starts = []
        for k in self.prior.causes.tolist():
            sizes = self.grids[k]
            if k in members or not sizes.size:
                continue
            loss = 0.5 * sizes**2 / SLAB**2 + self._loss(near, residuals, k)
            row = int(np.argmin(loss))
            starts.append((float(loss[row]), k, np.where(np.arange(base.size) == k, sizes[row], theta)))
        return [(k, own) for _, k, own in sorted(starts, key=lambda start: start[:2])]

    def _loss(self, near: Sequence[Observation], residuals: Sequence[FloatArray], k: int) -> FloatArray:
        """Return (sizes,) Σ ½ (ν + N) log(ν + N |r|²/n) over groups of all tests, with a parameter at every size."""
        total: dict[tuple[str, str], FloatArray] = {}
        number: dict[tuple[str, str], float] = {}
        for one, residual, table in zip(near, residuals, self.tables[k], strict=True):
            squares = np.minimum((residual - table) ** 2 / one.noise, LARGEST**2)
            for (name, places), size in zip(one.parts, one.effective.tolist(), strict=True):
                total[name] = total.get(name, 0.0) + size * squares[:, places].mean(axis=1)
                number[name] = number.get(name, 0.0) + size
        return np.asarray(
            sum(0.5 * (DEGREES + number[name]) * np.log(DEGREES + total[name]) for name in total)
        )


def _grid(data: TestRuns, prior: SizePrior, k: int) -> FloatArray:
    """Return the sizes of a parameter that a proposal tries: all that are no background."""
    known = np.concatenate([one.curves[k].coordinates for one in data.observations])
    ends = max(prior.low[k], known.min()), min(prior.high[k], known.max())
    sizes = np.unique(np.concatenate([known, np.linspace(*ends, GRID)]))
    return sizes[(np.abs(sizes) >= UNNAMED) & (sizes >= prior.low[k]) & (sizes <= prior.high[k])]
