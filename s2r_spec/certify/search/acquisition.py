"""Choice of the next tests: modified GP-UCB in batches (GP-BUCB), after the tests that long axes lack.

Once the verdict is known, a batch repeats a test: only the test of R then lacks outcomes, and repeats give them.

Sources: Akella, Ubellacker and Ames for the rule; Desautels, Krause and Burdick, *Parallelizing
exploration-exploitation tradeoffs in Gaussian process bandit optimization* (2014), for batches.
"""

from __future__ import annotations

import math

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.search.state import SearchState


def next_batch(state: SearchState) -> list[tuple[int, int]]:
    """Return (index of the point, replicates) of the next tests."""
    if tests := coverage_tests(state):
        return [(state.confidence.bounds.add(vector), replicates) for vector, replicates in tests]
    if again := repeats(state):
        return again
    spread, size = state.settings.spread, batch_size(state)
    shares = [size // spread + (i < size % spread) for i in range(spread)]
    # May be fewer tests than shares.
    return list(zip(_upper_confidence_tests(state, shares), shares, strict=False))


def batch_size(state: SearchState) -> int:
    """Return the rollouts of a batch. Every test is replicated: only scatter between replicates can refute R."""
    return max(2 * state.settings.spread, _share(state))


def repeats(state: SearchState) -> list[tuple[int, int]]:
    """Return (index of the point, replicates) of the repeats that the test of R lacks, if the verdict is known.

    The point is the tested one of largest upper bound. A query of m replicates has m − 1 degrees of freedom.
    """
    if not state.lacking:
        return []
    at = state.outcomes.samples.at
    worst = at[int(state.confidence.bounds.upper[0][at].argmax())]
    return [(int(worst), min(1 + state.lacking, batch_size(state)))]


def coverage_tests(state: SearchState) -> list[tuple[FloatArray, int]]:
    """Return (point, replicates) of the missing tests on axes that are shorter than their lengthscale."""
    if not state.coverage.axes:
        return []
    settings = state.settings
    needed = state.coverage.needed(settings.R, max(state.confidence.width, settings.epsilon), settings.delta)
    return state.coverage.design(state.tested, state.outcomes.samples.counts, needed, _generator(state))


def _upper_confidence_tests(state: SearchState, shares: list[int]) -> list[int]:
    """Return the points of largest upper bound, one after the other, each with its share of the rollouts.

    GP-BUCB: after each choice the posterior deviation shrinks as if the test were done, and the mean stays the same.
    A batch that is larger than its share ``batch`` ends with the test after which, by this estimate, ε is reached.
    """
    rng, confidence = _generator(state), state.confidence
    upper, lower, hidden = confidence.bounds.upper[0], confidence.bounds.lower[0], confidence.bounds.hidden[0]
    chosen = [_argmax(upper, rng)]
    planned = state.outcomes.samples.add(chosen[0], shares[0], 0.0)
    mean, width, scale = confidence.tightest(chosen[0])
    oversized = state.outcomes.rollouts > 0 and sum(shares) > _share(state)
    for share in shares[1:]:
        std = confidence.deviation(planned, scale)
        likely = np.minimum(upper, mean + width * std)
        if oversized:
            best = np.maximum(lower, mean - width * std).max()
            if likely.max() + hidden - best <= state.settings.epsilon / state.settings.R:
                break
        chosen.append(_argmax(likely, rng))
        planned = planned.add(chosen[-1], share, 0.0)
    return chosen


def _share(state: SearchState) -> int:
    return math.ceil(state.settings.batch * state.outcomes.rollouts)


def _generator(state: SearchState) -> np.random.Generator:
    return np.random.default_rng([state.settings.seed, state.queries])


def _argmax(values: FloatArray, rng: np.random.Generator) -> int:
    return int(rng.choice(np.flatnonzero(values >= values.max() - 1e-12 * max(1.0, abs(values.max())))))
