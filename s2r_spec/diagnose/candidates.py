"""Sets of effects that may explain the tests, each at runs of the simulator of its own.

Where five or more tests of the specification were run, the posterior over sets comes from predictions of left-out tests
(:mod:`.inference.prediction`). A set is proposed from the library: every parameter alone over its whole range, all of
an effect at a common size, then further ones beside the sets that predict best. It counts only at its own estimate,
where the simulator has run.

Units: sizes in typical sizes. Shapes: K parameters; of each test m observables, of which n are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.backend import Backend
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LARGEST
from s2r_spec.diagnose.inference.misfit import Misfit, energies
from s2r_spec.diagnose.inference.model_search import ModelPosterior, Set
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prediction import Candidate, fitted, weighted
from s2r_spec.diagnose.inference.prior import NAMED, SLAB, UNNAMED, SizePrior
from s2r_spec.diagnose.inference.recorded import Recorded
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import simulated_rows
from s2r_spec.diagnose.simulator.response import ResponseLibrary, replicates
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory

FEWEST = 5
"""Level: tests from which on predictions decide which effects there are."""
ALONE, BESIDE, LARGEST_SET = 6, 3, 4
"""Budget: single parameters, and further ones beside each of the two best sets, at which the simulator runs; causes of
a set."""
POLISHED = 3
"""Budget: further runs at the estimate of the best set."""
GAIN = 0.5
"""Tolerance: least gain of such a run in the log predictive density of all tests [nat]."""
GRID = 17
"""Budget: sizes at which a proposal compares the library with the tests, beside those of the library."""
WHOLE = 2.0
"""Budget: largest common size of all parameters of an effect that a proposal tries, in typical sizes."""
SECONDS, MOST = 60.0, 8
"""Budget: declared time of all runs of a search [s]; most runs of a test, as many as there are nominal ones."""
SIMULATED = 24
"""Definition: sizes at which a search mostly simulates every test; the runs of a test follow from them."""

Simulate = Callable[[FloatArray], "list[FloatArray]"]
"""Returns (R, m) observables of the simulator's runs of every test at (K,) sizes."""


@dataclass(frozen=True)
class Predicted:
    """The posterior over the sets at which the simulator ran, these sets, and what the most probable one leaves."""

    posterior: ModelPosterior
    candidates: Mapping[Set, Candidate]
    misfit: Misfit


def predicted(
    backend: Backend,
    library: ResponseLibrary,
    tests: Mapping[Experiment, Sequence[Trace]],
    prior: SizePrior,
    executor: ExecutorFactory | None = None,
    proposed: Sequence[tuple[Set, FloatArray]] = (),
    numbers: Sequence[FloatArray] | None = None,
) -> Predicted | None:
    """Return the posterior by predictions of left-out tests; None where there are fewer than :data:`FEWEST`.

    Args:
        backend: the nominal simulator.
        library: its responses.
        tests: of the specification → real runs, with residuals.
        prior: of the sizes.
        executor: of the simulations.
        proposed: further sets with (K,) their sizes.
        numbers: (G,) independent numbers of the groups of every test; those of the library if not given.
    """
    data = Recorded.of(backend, library, tests).counting(numbers)
    if len(data.runs) < FEWEST:
        return None
    responses = [one.response for one in data.observations]
    often = int(SECONDS / (max(float(backend.cost), 1e-4) * len(responses) * SIMULATED))
    runs = min(max(often, *(replicates(one.experiment) for one in responses)), MOST)
    ran: dict[bytes, list[FloatArray]] = {}

    def simulate(theta: FloatArray) -> list[FloatArray]:
        if (key := theta.tobytes()) not in ran:
            ran[key] = simulated_rows(backend, responses, library.values(theta), executor, runs)
        return ran[key]

    search = _Search(data, prior, simulate)
    search.run(proposed)
    posterior = weighted(search.found, prior)
    left = Misfit.of(data.observations, search.before, search.found[posterior.sets[0]].energy)
    return Predicted(posterior, search.found, left)


class _Search:
    """The candidates so far. They grow."""

    def __init__(self, data: Recorded, prior: SizePrior, simulate: Simulate) -> None:
        self.data, self.prior, self.simulate = data, prior, simulate
        self.background = data.background
        self.found: dict[Set, Candidate] = {}
        self.before = np.zeros(0)
        self.near: dict[Set, list[Observation]] = {}
        alone = {(k,): _grid(data, prior, k) for k in prior.causes.tolist()}
        self.grids: dict[Set, FloatArray] = alone | _whole_effects(prior)
        self.tables = {
            own: [np.sum([_table(one, k, sizes) for k in own], axis=0) for one in data.observations]
            for own, sizes in self.grids.items()
        }

    def run(self, proposed: Sequence[tuple[Set, FloatArray]]) -> None:
        """Try the empty set, single parameters, proposed sets, and further parameters beside the best ones."""
        nominal = np.zeros(self.prior.low.size)
        self.try_set((), nominal)
        self.before = energies(self.near[()], self.background, nominal)
        for own, theta in self.screened(())[:ALONE]:
            self.try_set(own, theta)
        for members, theta in proposed:
            self.try_set(members, theta)
        for size in range(1, LARGEST_SET):
            best = [members for members in self.ranked() if len(self.prior.effects(members)) == size][:2]
            for members in best:
                self.try_set(members, self.found[members].theta, again=True)
                for own, theta in self.screened(members)[:BESIDE]:
                    self.try_set(tuple(sorted({*members, *own})), theta)
            if len(self.prior.effects(self.ranked()[0])) <= size:
                break
        self.try_set((), self.found[()].theta, again=True)
        self.polish()
        self.close()

    def close(self) -> None:
        """Compare the best set and the ones without each of its causes at runs near the same sizes; then its rivals."""
        final = self.ranked()[0]
        for own in self.prior.effects(final).values():
            theta = self.found[final].theta.copy()
            theta[list(own)] = np.clip(theta[list(own)], -UNNAMED, UNNAMED)
            self.try_set(tuple(x for x in final if x not in own), theta, again=True)
        for members in self.best_and_rivals():
            if members in self.near and self.shown(members):
                self.compare(members)

    def best_and_rivals(self) -> list[Set]:
        """Return the best set, and for each of its large effects the best set without this effect."""
        ranked = self.ranked()
        final = self.found[ranked[0]]
        large = self.prior.effects(k for k in final.members if abs(final.theta[k]) >= NAMED)
        without = [
            next(one for one in ranked if effect not in self.prior.effects(self.shown(one)))
            for effect in large
        ]
        return list(dict.fromkeys([ranked[0], *without]))

    def shown(self, members: Set) -> Set:
        """Return the causes of a set that are no background."""
        return tuple(k for k in members if abs(self.found[members].theta[k]) >= UNNAMED)

    def polish(self) -> None:
        """Run the simulator at the estimate of the best set, as long as the tests are then predicted better."""
        for _ in range(POLISHED):
            best = self.ranked()[0]
            before = self.score(best)
            self.try_set(best, self.found[best].theta, again=True)
            if self.score(best) - before < GAIN:
                break

    def compare(self, best: Set) -> None:
        """Fit a set with each other parameter, and the sets with its large causes, around its own runs, too.

        The scatter of a few runs changes a score by several nats, so of many sets one is best by luck. Around common
        runs this luck is common. There a parameter that the tests do not show is as probable as before, and as wide.
        """
        longer = [tuple(sorted({*best, k})) for k in self.prior.causes.tolist()]
        large = {k for k in best if abs(self.found[best].theta[k]) >= NAMED}
        for members in dict.fromkeys([*(one for one in self.found if large <= {*one}), *longer]):
            theta = self.found.get(members, self.found[best]).theta
            new = fitted(self.near[best], self.background, theta, self.prior, members)
            if members not in self.found or new.score.sum() > self.score(members):
                self.found[members] = new

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

    def screened(self, members: Set) -> list[tuple[Set, FloatArray]]:
        """Return further parameters and (K,) sizes with them, the nearest to the tests first."""
        base = self.found[members].theta
        above = self.data.observations[0].dependence.base
        keep = np.isin(np.where(above >= 0, above, np.arange(base.size)), members)
        theta, near = np.where(keep, base, 0.0), self.near[members]
        residuals = [one.residual(theta) for one in near]
        starts = []
        for own, points in self.grids.items():
            if {*own} & {*members} or not points.size:
                continue
            loss = 0.5 * (points[:, own] ** 2).sum(axis=1) / SLAB**2 + self._loss(near, residuals, own)
            loss -= self.prior.log_odds(own)
            row = int(np.argmin(loss))
            starts.append((float(loss[row]), own, np.where(points[row] == 0.0, theta, points[row])))
        return [(own, sizes) for _, own, sizes in sorted(starts, key=lambda start: start[:2])]

    def _loss(self, near: Sequence[Observation], residuals: Sequence[FloatArray], members: Set) -> FloatArray:
        """Return (sizes,) Σ ½ (ν + N) log(ν + N |r|²/n) over groups of all tests, with parameters at every size."""
        total: dict[tuple[str, str], FloatArray] = {}
        number: dict[tuple[str, str], float] = {}
        for one, residual, table in zip(near, residuals, self.tables[members], strict=True):
            squares = np.minimum((residual - table) ** 2 / one.noise, LARGEST**2)
            for (name, places), size in zip(one.parts, one.effective.tolist(), strict=True):
                total[name] = total.get(name, 0.0) + size * squares[:, places].mean(axis=1)
                number[name] = number.get(name, 0.0) + size
        each = [0.5 * (DEGREES + number[name]) * np.log(DEGREES + total[name]) for name in total]
        return np.asarray(np.sum(each, axis=0))


def _grid(data: Recorded, prior: SizePrior, k: int) -> FloatArray:
    """Return (points, K) sizes of a parameter that a proposal tries: all that are no background.

    With each, its dependent parameters are nominal, or one of them has a size of the library.
    """

    def known(parameter: int) -> FloatArray:
        return np.unique(np.concatenate([one.curves[parameter].coordinates for one in data.observations]))

    own = known(k)
    ends = max(prior.low[k], own.min()), min(prior.high[k], own.max())
    sizes = np.unique(np.concatenate([own, np.linspace(*ends, GRID)]))
    sizes = sizes[(np.abs(sizes) >= UNNAMED) & (sizes >= prior.low[k]) & (sizes <= prior.high[k])]
    dependents = np.flatnonzero(data.observations[0].dependence.base == k)
    beside = [(k, 0.0), *((int(d), x) for d in dependents for x in known(int(d)).tolist() if x)]
    points = np.zeros((len(beside), sizes.size, prior.low.size))
    for rows, (d, x) in zip(points, beside, strict=True):
        rows[:, d] = x
        rows[:, k] = sizes
    return points.reshape(-1, prior.low.size)


def _whole_effects(prior: SizePrior) -> dict[Set, FloatArray]:
    """Return all parameters of each effect that has several, and (points, K) common sizes of them."""
    found: dict[Set, FloatArray] = {}
    for effect in np.unique(prior.effect).tolist():
        members = prior.causes[prior.effect[prior.causes] == effect]
        if members.size > 1:
            low, high = float(prior.low[members].max()), float(prior.high[members].min())
            sizes = np.linspace(max(low, -WHOLE), min(high, WHOLE), GRID)
            sizes = sizes[np.abs(sizes) >= UNNAMED]
            points = np.zeros((sizes.size, prior.low.size))
            points[:, members] = sizes[:, None]
            found[tuple(members.tolist())] = points
    return found


def _table(one: Observation, k: int, points: FloatArray) -> FloatArray:
    """Return (points, n) the response of a test to a parameter and its dependents at (points, K) sizes."""
    sizes = {x: one.curves[k].at(x) for x in np.unique(points[:, k]).tolist()}
    table = np.array([sizes[x] for x in points[:, k].tolist()]).reshape(len(points), one.observed.size)
    for d in np.flatnonzero(one.dependence.base == k).tolist():
        for row in np.flatnonzero(points[:, d]).tolist():
            factor = points[row, k] / one.dependence.at[d]
            table[row] += factor * one.curves[d].at(float(points[row, d]))
    return table
