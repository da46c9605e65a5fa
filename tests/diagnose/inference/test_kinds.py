"""Ratios of variances over groups of one kind."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.kinds import Kinds
from tests.diagnose.inference.test_prediction import nominal


def test_a_ratio_of_two_estimated_variances_has_no_bias():
    data, rng = nominal(tests=8), np.random.default_rng(0)
    sizes = [one.observed.size for one in data]
    found = []
    for _ in range(200):
        above, below = ([rng.chisquare(m, n) / m for n in sizes] for m in (1, 7))
        found += [own.mean() for own in Kinds.of(data).ratios(above, below, [1.0] * 8)]
    assert np.mean(found) == pytest.approx(1.0, abs=0.03)


def test_few_variances_leave_the_ratio_near_one():
    data = nominal(tests=1)
    large, small = np.full(data[0].observed.size, 9.0), np.ones(data[0].observed.size)
    (few,) = Kinds.of(data).ratios([large], [small], [1.0])
    (many,) = Kinds.of(data).ratios([large], [small], [1e6])
    assert np.all((few > 1.0) & (few < 9.0))
    assert many == pytest.approx(9.0, rel=1e-3)
    (none,) = Kinds.of(data).ratios([np.full_like(large, np.nan)], [small], [1.0])
    assert none == pytest.approx(1.0)
