"""The gap over the test space as an improved simulator has it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose import design
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.diagnose.where.space import Foretold, grid_of
from s2r_spec.rollouts.seeds import Stream, rollout_seed

FloatArray = NDArray[np.float64]

SECONDS = 10.0
"""Of one core, that both simulators should take over the test space."""
PLACES = 400
"""Tests over the space, however cheap a rollout is."""


def foretell(
    bench: Bench,
    values: Mapping[str, Mapping[str, float]],
    tests: Sequence[Test],
    seed: int,
    executor: Callable[[], Executor] | None = None,
) -> Foretold:
    """Simulate the gap at the tests that were run and over the test space, with and without these effects.

    Args:
        bench: the simulator.
        values: effects of the improved one.
        tests: that were run.
        seed: of the rollouts; both simulators have the same.
        executor: makes a pool; None runs all here.
    """
    space = bench.spec.space
    grid = grid_of(space)
    short = replace(bench, features=None)
    places = _places(short, len(grid))
    runs = [
        (test, rollout_seed(seed, number, 0, Stream.FORETELL))
        for number, test in enumerate((*tests, *places))
    ]
    jobs = [Job(v, (run,)) for run in runs for v in ({}, values)]
    rho = np.array([row[0, 0] for row in run_jobs(short, jobs, executor)]).reshape(-1, 2)
    gap = rho[:, 1] - rho[:, 0]
    box = design.unit_box(space, [space.point(place) for place in grid])
    between = design.weights(design.unit_box(space, places), box)
    return Foretold(gap[: len(tests)], between @ gap[len(tests) :])


def _places(bench: Bench, most: int) -> list[dict[str, float]]:
    """Return as many tests as there is time to simulate, evenly over the space, and at least those of the bank."""
    space = bench.spec.space
    able = min(int(SECONDS / (2.0 * bench.cost)), PLACES, most)
    across = int(able ** (1.0 / space.dim) + 1e-9)
    least = design.grid(space)
    if across**space.dim <= len(least) or across < 3:
        return least
    return [space.point(place) for place in space.grid((across,) * space.dim)]
