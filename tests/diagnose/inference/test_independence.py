"""Independent numbers in the scatter of runs, of a group and of groups that scatter together."""

from itertools import combinations

import numpy as np
import pytest

from s2r_spec.diagnose.inference.independence import squares

RUNS, NUMBERS = 8, 60


def number(rows):
    """Return the independent numbers of (R, n) runs, of many experiments."""
    pairs = list(combinations(range(RUNS), 2))
    disjoint = np.array([[not {*a} & {*b} for b in pairs] for a in pairs])
    each = [squares(np.array([own[i] - own[j] for i, j in pairs]), disjoint) for own in rows]
    lengths, products = np.sum(each, axis=0)
    return lengths / products


@pytest.mark.parametrize("alike", [1, 3, 20])
def test_numbers_that_are_alike_count_once(alike):
    rng = np.random.default_rng(0)
    rows = [np.repeat(rng.normal(size=(RUNS, NUMBERS // alike)), alike, axis=1) for _ in range(40)]
    assert number(rows) == pytest.approx(NUMBERS / alike, rel=0.15)


def test_a_mean_that_all_runs_share_changes_nothing():
    rng = np.random.default_rng(1)
    rows = [100.0 + rng.normal(size=(RUNS, NUMBERS)) for _ in range(40)]
    assert number(rows) == pytest.approx(NUMBERS, rel=0.15)


def test_few_large_errors_among_many_small_ones_are_few():
    rng = np.random.default_rng(2)
    deviation = np.where(np.arange(NUMBERS) < 3, 10.0, 1.0)
    rows = [deviation * rng.normal(size=(RUNS, NUMBERS)) for _ in range(40)]
    assert number(rows) == pytest.approx((deviation**2).sum() ** 2 / (deviation**4).sum(), rel=0.15)
