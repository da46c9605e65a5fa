"""Where the real tests lie, and what follows from that alone: functions of the test, and their scatter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.design import basis, unit_box, weights
from s2r_spec.space import Space, key_of

FloatArray = NDArray[np.float64]
Test = Mapping[str, float]

SHOTS = 2
"""Rollouts of the nominal simulator at every real test."""


@dataclass(frozen=True)
class Layout:
    """Distinct tests, and the functions of the test on which a gap is projected.

    Attributes:
        tests: n distinct ones.
        place: (rollouts,) which of them each real rollout is of.
        points: (n, dim) in the box [−1, 1].
        project: (q, n) from values at the tests to coefficients of functions of the test.
        interpolate: (n, m) from the bank's tests to these.
        through: (q, m) from the bank's tests to coefficients.
        scatter: (q, q) covariance of the coefficients of real less nominal, in units of one rollout's.
        apart: whether the tests are not projected at all, each a function of its own.
    """

    tests: tuple[Test, ...]
    place: NDArray[np.intp]
    points: FloatArray
    project: FloatArray
    interpolate: FloatArray
    through: FloatArray
    scatter: FloatArray
    apart: bool = False

    @classmethod
    def of(cls, space: Space, known: Sequence[Test], tests: Sequence[Test], inflation: float = 1.0) -> Layout:
        """Lay out one real rollout at each of ``tests``; ``known`` are the bank's.

        ``inflation`` is how much more the real rollouts' variance is than the simulator's.
        """
        distinct = {key_of(test): test for test in tests}
        order = {key: k for k, key in enumerate(distinct)}
        place = np.array([order[key_of(test)] for test in tests], dtype=np.intp)
        points = unit_box(space, list(distinct.values()))
        variance = inflation / np.bincount(place) + 1.0 / SHOTS
        b = functions(points)
        heavy = 1.0 / np.sqrt(variance)
        project = np.asarray(np.linalg.pinv(b * heavy[:, None]) * heavy, dtype=np.float64)
        interpolate = weights(unit_box(space, known), points)
        return cls(
            tuple(distinct.values()),
            place,
            points,
            project,
            interpolate,
            project @ interpolate,
            (project * variance) @ project.T,
        )

    def each(self, inflation: float) -> Layout:
        """Return the same tests, each by itself: for what happens at a few of them only, or varies without a trend."""
        count = np.bincount(self.place)
        return replace(
            self,
            project=np.eye(len(self.tests)),
            through=self.interpolate,
            scatter=np.diag(inflation / count + 1.0 / SHOTS),
            apart=True,
        )

    def level(self, data: FloatArray) -> FloatArray:
        """Return (k,) mean squares over the tests of what has these coefficients (q, k)."""
        found: FloatArray = (data**2).mean(axis=0) if self.apart else (data**2).sum(axis=0)
        return found

    def variance(self, machine: FloatArray, simulator: FloatArray) -> FloatArray:
        """Return (q, k) scatter of the coefficients, from (k,) that of one rollout of the machine and the simulator."""
        of_tests = self.project**2
        found: FloatArray = np.outer(of_tests @ (1.0 / np.bincount(self.place)), machine) + np.outer(
            of_tests.sum(axis=1) / SHOTS, simulator
        )
        return found

    @property
    def root(self) -> FloatArray:
        """(q, q) Cholesky factor of ``scatter``."""
        return np.asarray(np.linalg.cholesky(self.scatter), dtype=np.float64)

    def mean(self, rows: FloatArray) -> FloatArray:
        """Return (n, p) means of (rollouts, p) over the rollouts of each test."""
        total = np.zeros((len(self.tests), rows.shape[1]))
        np.add.at(total, self.place, rows)
        return total / np.bincount(self.place)[:, None]

    def scattered(self, rows: FloatArray) -> tuple[FloatArray, int]:
        """Return the pure error of (rollouts, p): (p,) variance between replicates, and its degrees of freedom."""
        rest = rows - self.mean(rows)[self.place]
        free = len(rows) - len(self.tests)
        return (rest**2).sum(axis=0) / max(free, 1), free

    def spread(self, count: int) -> NDArray[np.intp]:
        """Return the places of so many tests that lie well apart, at least enough for every function."""
        count = min(max(count, self.project.shape[0] + 2), len(self.tests))
        centre = np.linalg.norm(self.points, axis=1)
        chosen = [int(centre.argmax())]
        while len(chosen) < count:
            away = np.linalg.norm(self.points[:, None] - self.points[chosen], axis=2).min(axis=1)
            away[chosen] = -1.0
            chosen.append(int(away.argmax()))
        return np.array(sorted(chosen), dtype=np.intp)

    def projected_from(self, places: NDArray[np.intp]) -> FloatArray:
        """Return (q, len(places)): as ``project``, from values at some of the tests alone."""
        if len(places) == len(self.tests):
            return self.project
        b = functions(self.points)[places]
        return np.asarray(np.linalg.pinv(b, rcond=1e-3), dtype=np.float64)


def functions(points: FloatArray) -> FloatArray:
    """Return (n, q): as many functions of the test as these tests can tell apart."""
    full = basis(points)
    distinct = len(np.unique(points.round(9), axis=0)) if points.shape[1] else 1
    wanted = min(full.shape[1], max(1, distinct - 1)) if distinct > 1 else 1
    for count in range(wanted, 1, -1):
        b = full[:, :count]
        if np.linalg.cond(b) < 30.0:
            return b
    return full[:, :1]
