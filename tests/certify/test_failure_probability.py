"""Bounds on probabilities hold, and a broken one is caught."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import binom

from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.result import failure_probability as module
from s2r_spec.certify.result.failure_probability import bound_failure_probability
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space

LINE = Space.of({"vd": (-0.2, 0.3)}, {"vd": "m/s"})
KERNEL = Kernel("matern52", 0.2)
RUNS, DELTA = 20, 0.1
# P(more of them wrong) < 0.01 if each run is wrong with probability 0.1.
MOST_WRONG = int(binom.isf(0.01, RUNS, DELTA))


def probability(rng):
    """A function into [0, 1] of known norm: sections of the kernel with positive weights."""
    centres = rng.uniform(-0.2, 0.3, (4, 1))
    weights = rng.dirichlet(np.ones(4)) * rng.uniform(0.1, 1)
    norm = float(np.sqrt(weights @ KERNEL.gram(centres, centres) @ weights))
    return (lambda points: KERNEL.gram(np.atleast_2d(points), centres) @ weights), norm


def rollouts(function, rng, seed):
    """Tests that a search for the worst mean chose; ρ is −1 with the probability of the test, else 1."""
    search = Search(LINE, kernel=KERNEL, B=3, R=1, delta=0.1, epsilon=0.3, budget=150, seed=seed)
    done = []
    while not search.done:
        for query in search.ask():
            fails = rng.uniform(size=query.replicates) < function([[query.point["vd"]]])[0]
            rho = np.where(fails, -1.0, 1.0)
            done.append((query.point, rho))
            search.tell(query, -rho)
    return done


@cache
def searched(seed):
    """Return a random probability, its norm, and the rollouts of a search: all bounds are of the same ones."""
    rng = np.random.default_rng([3, seed])
    function, norm = probability(rng)
    return function, norm, rollouts(function, rng, seed)


def wrong_or_refused(runs=RUNS):
    count = 0
    for seed in range(runs):
        function, norm, done = searched(seed)
        found = bound_failure_probability(LINE, done, [0.0], kernel=KERNEL, B=2 * norm, delta=DELTA)[0]
        truth = function(np.linspace(-0.2, 0.3, 1001)[:, None]).max()
        count += bool(found.refused) or not found.lower <= truth <= found.upper
    return count


@pytest.mark.parametrize("runs", [12, pytest.param(60, marks=pytest.mark.slow)])
def test_the_bound_holds_and_is_given(runs):
    assert wrong_or_refused(runs) == 0


def test_with_a_smaller_proxy_than_hoeffdings_it_fails(monkeypatch):
    monkeypatch.setattr(module, "R", 0.05)
    assert wrong_or_refused() > MOST_WRONG


def test_levels_share_the_risk_and_are_ordered():
    rng = np.random.default_rng(0)
    tests = [({"vd": vd}, rng.normal(0.5, 0.3, size=40)) for vd in np.linspace(-0.2, 0.3, 15)]
    settings = {"kernel": KERNEL, "B": 3.0, "delta": 0.1}
    low, high = bound_failure_probability(LINE, tests, [-0.5, 0.4], **settings)
    assert low.seen < high.seen
    assert low.upper < high.upper
    assert high.lower > 0
    assert bound_failure_probability(LINE, tests, [-0.5], **settings)[0].upper < low.upper  # the whole of δ
    assert all(0 <= one.lower <= one.upper <= 1 and not one.refused for one in (low, high))


def test_a_norm_that_the_rollouts_contradict_is_refused():
    tests = [({"vd": vd}, [-1.0] * 200) for vd in (-0.2, 0.0, 0.3)]
    found = bound_failure_probability(LINE, tests, [0.0], kernel=KERNEL, B=0.5, delta=0.1)[0]
    assert "B = 0.5" in found.refused


def test_a_norm_of_less_than_twice_what_the_rollouts_show_is_refused():
    tests = [({"vd": vd}, [-1.0] * 200) for vd in (-0.2, 0.0, 0.3)]

    def bounded(B):
        return bound_failure_probability(LINE, tests, [0.0], kernel=KERNEL, B=B, delta=0.1)[0]

    least = bounded(5.0).B_low
    assert bounded(1.5 * least).refused
    assert not bounded(2.5 * least).refused


def test_nothing_is_bounded_by_nothing():
    with pytest.raises(UsageError, match="rollout"):
        bound_failure_probability(LINE, [], [0.0], kernel=KERNEL, B=1, delta=0.1)
