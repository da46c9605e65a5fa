"""The gap over the test space that an improved simulator predicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.gap.surface import Predicted
from s2r_spec.diagnose.gap.test_space import grid_of, in_cube
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.rollouts.seeds import Stream, rollout_seed

FloatArray = NDArray[np.float64]

SECONDS = 10.0
"""Budget: time of one core [s] for both simulators over the test space. Doubled, up to twice as many tests; three
along each axis are run all the same."""
PLACES = 400
"""Budget: the most tests over the space. Doubled, a cheap simulator has a finer grid."""


def predict(
    bench: Bench,
    values: Mapping[str, Mapping[str, float]],
    tests: Sequence[Test],
    seed: int,
    executor: Callable[[], Executor] | None = None,
) -> Predicted:
    """Simulate ρ with and without effects, at the tests that were run and over the test space.

    Args:
        bench: the simulator.
        values: effects of the improved simulator.
        tests: the tests that were run.
        seed: of the rollouts; both simulators use the same.
        executor: makes a pool; None runs all here.
    """
    from scipy.interpolate import RBFInterpolator

    space = bench.spec.space
    grid = grid_of(space)
    able = min(SECONDS / (2.0 * max(float(bench.backend.cost), 1e-4)), PLACES, len(grid))
    places = space.grid((max(int(able ** (1.0 / space.dim) + 1e-9), 3),) * space.dim)
    runs = [
        (test, rollout_seed(seed, number, 0, Stream.FORETELL))
        for number, test in enumerate((*tests, *map(space.point, places)))
    ]
    jobs = [Job(v, (run,)) for run in runs for v in ({}, values)]
    rho = np.array([row[0, 0] for row in run_jobs(bench, jobs, executor)]).reshape(-1, 2)
    gap = rho[:, 1] - rho[:, 0]
    between = RBFInterpolator(in_cube(space, places), gap[len(tests) :], kernel="linear", degree=1)
    return Predicted(gap[: len(tests)], between(in_cube(space, grid)))
