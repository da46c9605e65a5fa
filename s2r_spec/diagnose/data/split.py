"""Train and held-out rollouts: sizes are estimated from the first, and the gap before and after from the second."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.diagnose.data.rollouts import FEWEST, RealRollouts
from s2r_spec.diagnose.simulator.bench import TestRun
from s2r_spec.space import key_of

LEAST = 3
"""Budget: fewest tests whose gap is measured."""
HELD_OUT = 0.3
"""Budget: share of the tests that is held out."""
ENOUGH = (9, 2 * FEWEST)
"""Budget: different tests, and runs of tests, from which on some are held out. The first follows from the two above."""
ACCIDENTS = 0.1
"""Tolerance: share of the tests that may have failed by accident, or one."""


@dataclass(frozen=True)
class TrainHeldOut:
    """Rollouts for the estimate, with all runs of protocols, and tests for the gap; empty if there are too few."""

    train: RealRollouts
    held_out: tuple[TestRun, ...]


def split(rollouts: RealRollouts, seed: int, apart: int = 0) -> TrainHeldOut:
    """Return the rollouts in two parts.

    A few tests that failed by accident are left out of both. One fall outweighs all else in ρ, and says nothing about
    the others. Where falls are common, they are part of the gap and stay. A campaign holds the first ``apart`` tests
    out; else whole tests are drawn.
    """
    tests = rollouts.tests
    used = [i for i, (_, trace) in enumerate(tests) if trace.failure is None]
    failed = len(tests) - len(used)
    if failed > max(1, int(ACCIDENTS * len(tests))) or len(used) < FEWEST:
        used = list(range(len(tests)))
    held = set(used) & set(range(apart))
    if not apart:
        keys = [key_of(tests[i][0]) for i in used]
        different = list(dict.fromkeys(keys))
        count = number_held_out(len(different), len(used))
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
        out = {different[k] for k in rng.permutation(len(different))[:count]}
        held = {i for i, key in zip(used, keys, strict=True) if key in out}
        if len(different) == 1:  # rollouts of the one test are all that can be held out
            held = set(used[:count])
    return TrainHeldOut(
        replace(rollouts, tests=tuple(tests[i] for i in used if i not in held)),
        tuple(tests[i] for i in used if i in held),
    )


def number_held_out(different: int, runs: int) -> int:
    """Return how many of so many different tests are held out, with all their runs; of a single test, how many runs."""
    if different == 1:
        count = round(HELD_OUT * runs)
        return count if count >= LEAST else 0
    count = round(HELD_OUT * different)
    return 0 if count < LEAST or runs < ENOUGH[1] else count
