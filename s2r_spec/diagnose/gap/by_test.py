"""Compare all real rollouts with the simulator, test by test."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.gap.materiality import Materiality, RolloutsAtTest, materiality
from s2r_spec.diagnose.gap.tolerance import smallest_tolerance
from s2r_spec.diagnose.simulate import Bench, Job, Test, places_of, rho_and_end, run_jobs
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SIMULATED = 6
"""Budget: simulated rollouts of each test. With six, it is more than chance if single real rollouts fail at two tests
and no simulated one does. Doubled, intervals of single real rollouts get 2 % shorter."""


def compared_at_all_tests(
    bench: Bench,
    rollouts: Sequence[tuple[Test, Trace]],
    seed: int,
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Materiality:
    """Return whether the gap matters at any test of the real rollouts.

    Args:
        bench: the simulator without effects, and the spec.
        rollouts: (test, trace) of every real rollout, also of those that ended early.
        seed: of the simulations.
        executor: makes a pool for them; None runs them here.
        progress: called with the numbers of done and of all tests.

    Raises:
        UsageError: a ρ is infinite or not a number.
        BackendError: a simulation raised an error.
    """
    real = np.array([rho_and_end(bench, trace, test) for test, trace in rollouts])
    places = places_of([test for test, _ in rollouts])
    jobs = [
        Job({}, tuple((dict(key), rollout_seed(seed, n, k, Stream.MATERIALITY)) for k in range(SIMULATED)))
        for n, key in enumerate(places)
    ]
    rows = run_jobs(bench, jobs, executor, progress)
    tests = []
    for (key, own), simulated in zip(places.items(), rows, strict=True):
        (whole, failed), (other, fell) = (
            (each[each[:, 1] == 0.0, 0], int(each[:, 1].sum())) for each in (real[own], simulated)
        )
        tests.append(RolloutsAtTest(dict(key), whole, other, failed, fell))
    formula = bench.spec.formulas[bench.requirement]
    return materiality(tests, bench.spec.unit(bench.requirement), smallest_tolerance(formula))
