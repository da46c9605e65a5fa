"""What effects do at the real tests: from the bank, or from the simulator itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.joint import RIDGE
from s2r_spec.diagnose.layout import Layout
from s2r_spec.diagnose.signatures import Signatures
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs

FloatArray = NDArray[np.float64]

STEP = 0.2
"""Of a coordinate, for a derivative: wide enough to leave a dead zone, small beside a typical effect."""
LEAST = 0.15
"""Coordinate at which a secant from nominal is taken where the effect is smaller."""
THERE = 0.05
"""Coordinate from which on an effect is there enough to see how it acts."""
DEAD = 0.1
"""A derivative of less than this part of the secant to a typical effect is that of a dead zone."""
WORTH = 0.5
"""[s] of rollouts that are worth the way to a worker and back."""
SECONDS = 3.0
"""Of one core, that derivatives by simulation should take; with dearer rollouts they are taken at fewer tests."""
TOO_LONG = 8.0
"""[s] from which on the bank's derivatives have to do."""
REMEMBERED = 5000
"""Simulated tests that are kept, about a kB each."""
A_LOOK = 1.0
"""[s] that one look at the simulator should take; with dearer rollouts it is at fewer tests."""


class Surrogate:
    """The bank in the simulator's place: effects add up, and vary with the test as they do at the bank's tests."""

    def __init__(self, catalogue: Catalogue, through: FloatArray) -> None:
        """Project all curves on the functions of the real tests, ``through`` (q, m)."""
        self.catalogue = catalogue
        self.lower, self.upper, self.based = catalogue.lower, catalogue.upper, catalogue.based
        self._knots = []
        for curve in catalogue.curves:
            at = np.append(curve.coordinates, 0.0)
            seen = np.einsum("qm,gmk->gqk", through, curve.change)
            order = np.argsort(at)
            self._knots.append((at[order], np.concatenate([seen, np.zeros_like(seen[:1])])[order]))

    def along(self, line: int, coordinate: float) -> FloatArray:
        """Return (q, k): the line alone, at this coordinate."""
        at, seen = self._knots[line]
        x = float(np.clip(coordinate, at[0], at[-1]))
        high = int(np.clip(np.searchsorted(at, x), 1, len(at) - 1))
        part = (x - at[high - 1]) / (at[high] - at[high - 1])
        found: FloatArray = seen[high - 1] * (1.0 - part) + seen[high] * part
        return found

    def secant(self, line: int, coordinate: float) -> FloatArray:
        """Return (q, k): change per unit between nominal and this coordinate, or one nearby that can be seen."""
        at = self._knots[line][0]
        x = seen_from(coordinate, at[0], at[-1])
        found: FloatArray = self.along(line, x) / x
        return found

    def change(self, at: FloatArray) -> FloatArray:
        """Return (q, k): see :class:`~s2r_spec.diagnose.joint.Model`."""
        total: FloatArray = np.zeros_like(self._knots[0][1][0])
        for k, x in enumerate(at):
            if self.based[k]:
                total = total + at[self.catalogue.first[k]] * self.along(k, x)
            elif x:
                total = total + self.along(k, x)
        return total

    def jacobian(self, at: FloatArray) -> FloatArray:
        """Return (K, q, k): secants, which also say what is left when an effect is taken away."""
        rows = []
        for k, x in enumerate(at):
            if self.based[k]:
                rows.append(at[self.catalogue.first[k]] * self.secant(k, x))
                continue
            row = self.secant(k, x)
            for other in np.flatnonzero(self.based & (self.catalogue.first == k)):
                row = row + self.along(int(other), at[other])
            rows.append(row)
        return np.array(rows)

    def idle(self) -> list[int]:
        """Return the lines that do nothing until they are large: a limit that is not reached has no slope to follow."""
        out = []
        for k in np.flatnonzero(~self.based).tolist():
            sides = [s for s in (-1.0, 1.0) if s * (self.upper[k] if s > 0 else self.lower[k]) > LEAST]
            near = max((float(np.linalg.norm(self.along(k, s * LEAST))) for s in sides), default=0.0)
            usual = max((float(np.linalg.norm(self.along(k, s))) for s in sides), default=0.0)
            if near < DEAD * LEAST * usual:
                out.append(k)
        return out

    def scanned(
        self, data: FloatArray, variance: FloatArray, effect: int, turned: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return (K,) coordinates at which one effect alone fits the data best, and the part of them that it explains.

        All of the bank's values are looked at: a limit that is only reached far from nominal has no slope to follow.
        """
        root = 1.0 / np.sqrt(variance)
        whole = float(((data * root) ** 2).sum())
        best, least = turned, whole
        for k in np.flatnonzero((self.catalogue.owner == effect) & ~self.based):
            for x in self._knots[k][0]:
                at = np.where(self.based, turned, 0.0)
                at[k] = x
                left = float((((data - self.change(at)) * root) ** 2).sum())
                if left < least:
                    best, least = at, left
        return best, 1.0 - least / max(whole, 1e-12)

    def turned(self, data: FloatArray, variance: FloatArray, beside: bool = False) -> FloatArray:
        """Return (K,) coordinates to start from: of based lines where their effect fits the data best.

        Alone; or ``beside`` all others, so that what another explains as well says nothing of how this one acts.
        """
        begin = np.zeros(len(self.based))
        root = 1.0 / np.sqrt(variance)
        y = (data * root).ravel()
        free = np.flatnonzero(~self.based)
        columns = np.array([(self.secant(int(k), 1.0) * root).ravel() for k in free])
        for k in np.flatnonzero(self.based):
            main = self.secant(int(self.catalogue.first[k]), 1.0)
            turns = [((main + self.along(int(k), float(x))) * root).ravel() for x in self._knots[k][0]]
            others = columns[self.catalogue.owner[free] != self.catalogue.owner[k]] if beside else columns[:0]
            inner = np.linalg.inv(others @ others.T + np.eye(len(others)) / RIDGE**2)

            def left(x: FloatArray, others: FloatArray = others, inner: FloatArray = inner) -> FloatArray:
                return np.asarray(x - others.T @ (inner @ (others @ x)))

            rest = left(y)
            gains = [max(float(c @ rest), 0.0) ** 2 / max(float(c @ left(c)), 1e-12) for c in turns]
            begin[k] = self._knots[k][0][int(np.argmax(gains))]
        return begin


class Simulator:
    """The simulator itself, at the real tests, with the random numbers of its nominal rollouts."""

    def __init__(
        self,
        bench: Bench,
        signatures: Signatures,
        surrogate: Surrogate,
        layout: Layout,
        nominal: FloatArray,
        executor: Callable[[], Executor] | None,
        shots: int = 1,
    ) -> None:
        """Set up.

        Args:
            bench: what is simulated.
            signatures: of what is measured.
            surrogate: the bank at the real tests.
            layout: of these.
            nominal: (shots or more, n, 1 + p) rows of nominal rollouts at every real test.
            executor: makes a pool; None runs all here.
            shots: rollouts at a test whose mean is a look.
        """
        self.catalogue = catalogue = surrogate.catalogue
        self._surrogate = surrogate
        self.lower, self.upper, self.based = catalogue.lower, catalogue.upper, catalogue.based
        self._bench, self._signatures, self._layout = bench, signatures, layout
        self._nominal, self._executor, self.shots = nominal, executor, shots
        self._looked: dict[tuple[bytes, int], FloatArray] = {}

    def steadier(self, shots: int) -> Simulator:
        """Return the same, with so many rollouts at a test for a look."""
        return Simulator(
            self._bench, self._signatures, self._surrogate, self._layout, self._nominal, self._executor, shots
        )

    @property
    def nominal_rho(self) -> FloatArray:
        """Return (n,) mean ρ of the nominal rollouts at every real test."""
        return np.asarray(self._nominal[..., 0].mean(axis=0))

    @property
    def dear(self) -> bool:
        """Whether derivatives along every line by simulation would take too long."""
        return self.too_dear_for(len(self._few))

    def too_dear_for(self, tests: int) -> bool:
        """Return whether they would at so many tests."""
        return self._cost * tests * len(self.based) > TOO_LONG

    @property
    def _cost(self) -> float:
        """Time of one rollout and of what is read of it [s]."""
        return self._bench.cost

    @cached_property
    def _few(self) -> NDArray[np.intp]:
        """Places of the tests at which derivatives are taken."""
        return self._layout.spread(int(SECONDS / (self._cost * len(self.based))))

    @cached_property
    def _many(self) -> NDArray[np.intp]:
        """Places of the tests at which changes are looked at."""
        return self._layout.spread(int(A_LOOK / self._cost))

    def change(self, at: FloatArray) -> FloatArray:
        """Return (q, k): see :class:`~s2r_spec.diagnose.joint.Model`."""
        found: FloatArray = self._layout.projected_from(self._many) @ self._components([at], self._many)[0]
        return found

    def jacobian(self, at: FloatArray, only: NDArray[np.intp] | None = None) -> FloatArray:
        """Return (K, q, k) one-sided differences over :data:`STEP`, towards the longer side of the range.

        With dear rollouts these are the bank's secants, unless ``only`` a few lines are asked for; all others are 0.
        """
        if only is None and self.dear:
            return self._surrogate.jacobian(at)
        project = self._layout.projected_from(self._few)
        out = np.zeros((len(at), len(project), self._signatures.size))
        lines, points, steps = [], [at], []
        for k in range(len(at)) if only is None else only.tolist():
            if self.based[k] and abs(at[self.catalogue.first[k]]) < THERE:
                continue  # nothing is there that could act otherwise
            room = self.upper[k] - at[k], at[k] - self.lower[k]
            away = 1.0 if (at[k] >= 0 and room[0] >= STEP) or room[0] > room[1] else -1.0
            there = at.copy()
            there[k] += away * STEP
            lines.append(k)
            points.append(np.clip(there, self.lower, self.upper))
            steps.append(points[-1][k] - at[k])
        here, *found = self._components(points, self._few)
        for k, components, step in zip(lines, found, steps, strict=True):
            if step:
                out[k] = project @ (components - here) / step
            if not self.based[k] and abs(at[k]) < LEAST:
                # Some effects do nothing until they are large: a limit that is not reached.
                usual = self._surrogate.secant(k, 1.0 if self.upper[k] > 0 else -1.0)
                if np.linalg.norm(out[k]) < DEAD * np.linalg.norm(usual):
                    out[k] = usual
        return out

    def _components(self, points: Sequence[FloatArray], places: NDArray[np.intp]) -> list[FloatArray]:
        """Return (len(places), k) change of the components at each of these coordinates.

        A fit begins where another ended, and derivatives are taken where it stands: what was looked at is kept.
        """
        wanted = [[(at.tobytes(), int(place)) for place in places] for at in points]
        kept = {key: self._looked[key] for keys in wanted for key in keys if key in self._looked}
        new = [k for k, keys in enumerate(wanted) if not all(key in kept for key in keys)]
        for k, found in zip(new, self._simulated([points[k] for k in new], places), strict=True):
            kept.update(zip(wanted[k], found, strict=True))
        if len(self._looked) + len(kept) > REMEMBERED:
            self._looked.clear()
        self._looked.update(kept)
        return [np.array([kept[key] for key in keys]) for keys in wanted]

    def _simulated(self, points: Sequence[FloatArray], places: NDArray[np.intp]) -> list[FloatArray]:
        """Return the same, by rollouts."""
        kept = self._nominal[: self.shots, places].mean(axis=0)[:, self._signatures.kept]
        means = [rows.mean(axis=0) for rows in self._rows(points, places)]
        return [self._signatures.components(mean, kept) for mean in means]

    def _rows(self, points: Sequence[FloatArray], places: NDArray[np.intp]) -> list[FloatArray]:
        """Return (shots, len(places), 1 + p) rows of rollouts at each of these coordinates."""
        runs = tuple((self._layout.tests[i], seed_of(int(i), s)) for s in range(self.shots) for i in places)
        jobs = [Job(self.catalogue.values(at), runs) for at in points]
        executor = self._executor if self._cost * len(runs) * len(jobs) > WORTH else None
        if len(jobs) == 1 and executor is not None:
            # One simulator at many tests: shared out by tests.
            jobs = [Job(jobs[0].values, (run,)) for run in runs]
            found = [np.concatenate(run_jobs(self._bench, jobs, executor))]
        else:
            found = run_jobs(self._bench, jobs, executor)
        return [rows.reshape(self.shots, len(places), -1) for rows in found]

    def row_change(self, at: FloatArray) -> FloatArray:
        """Return (looks, 1 + p) change of ρ and of the features themselves from nominal, at the tests of a look."""
        found = self._rows([at], self._many)[0] - self._nominal[: self.shots, self._many]
        return np.asarray(found.reshape(-1, found.shape[-1]))

    def weights(self) -> FloatArray:
        """Return (looks, q, q) by which the coordinates that the equations ask for count in these rows."""
        each = self._bench.weights([self._layout.tests[i] for i in self._many])
        return np.tile(each, (self.shots, 1, 1))

    def variance(self, noise: FloatArray) -> FloatArray:
        """Return (q, k) scatter of a look, from (k,) that of one rollout."""
        of_tests = self._layout.projected_from(self._many) ** 2
        found: FloatArray = np.outer(of_tests.sum(axis=1) / self.shots, noise)
        return found

    def scattered(self, at: FloatArray) -> tuple[FloatArray, int]:
        """Return (k,) variance of one rollout's components there, and from how many degrees of freedom."""
        count = len(self._nominal)
        looks = [(self._layout.tests[i], seed_of(int(i), s)) for s in range(count) for i in self._many]
        values = self.catalogue.values(at)
        rows = np.concatenate(run_jobs(self._bench, [Job(values, (look,)) for look in looks], self._executor))
        kept = np.tile(self._nominal[:, self._many].mean(axis=0)[:, self._signatures.kept], (count, 1))
        found = self._signatures.components(rows, kept).reshape(count, len(self._many), -1)
        variance: FloatArray = found.var(axis=0, ddof=1).mean(axis=0)
        return variance, (count - 1) * len(self._many)


class Part:
    """Some lines of the simulator, all others held where they are."""

    def __init__(self, whole: Simulator, effects: Sequence[int], held: FloatArray) -> None:
        """Take the lines of these effects; ``held`` (K,) says where the others are."""
        self.lines = np.flatnonzero(np.isin(whole.catalogue.owner, effects))
        self.lower, self.upper = whole.lower[self.lines], whole.upper[self.lines]
        self.based = whole.based[self.lines]
        self._whole, self._held = whole, held

    def all(self, at: FloatArray) -> FloatArray:
        """Return (K,) coordinates of all lines."""
        out = self._held.copy()
        out[self.lines] = at
        return out

    def change(self, at: FloatArray) -> FloatArray:
        """Return (q, k): see :class:`~s2r_spec.diagnose.joint.Model`."""
        return self._whole.change(self.all(at))

    def jacobian(self, at: FloatArray) -> FloatArray:
        """Return (lines, q, k): see :class:`~s2r_spec.diagnose.joint.Model`."""
        return self._whole.jacobian(self.all(at), self.lines)[self.lines]


def seen_from(coordinate: float, low: float, high: float) -> float:
    """Return this coordinate of a line between these ends, or one nearby at which its effect can be seen."""
    x = float(np.clip(coordinate, low, high))
    if abs(x) >= LEAST:
        return x
    return float(np.clip(LEAST if (x >= 0.0 and high > 0.0) or low >= 0.0 else -LEAST, low, high))


def seed_of(test: int, shot: int) -> int:
    """Return the seed of the simulator's rollout at a real test."""
    return 7919 * shot + test


def nominal_rows(
    bench: Bench, tests: Sequence[Test], shots: int, executor: Callable[[], Executor] | None
) -> FloatArray:
    """Return (shots, n, 1 + p) of the nominal simulator at the real tests."""
    jobs = [Job({}, tuple((test, seed_of(i, s)) for s in range(shots))) for i, test in enumerate(tests)]
    return np.stack(run_jobs(bench, jobs, executor), axis=1)
