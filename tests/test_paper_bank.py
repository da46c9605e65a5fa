"""The system of recorded rollouts is what `benchmarks/paper/bank.py` says: its mean, minimum, norm and R."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from benchmarks.paper import bank
from s2r_spec.certify.bound.kernels import Kernel


def test_the_norm_of_a_kernel_section_is_1():
    """‖k(·, c)‖² = k(c, c); the spline through it has its norm but for what it cannot follow."""
    kernel = Kernel("matern52", 0.2)
    at = np.clip(bank.SPEEDS, bank.LOW, bank.HIGH)  # their mean may round out of the box
    for centre in (-0.2, 0.05, 0.3):
        section = kernel.gram(at[:, None], np.array([[centre]]))[:, 0]
        spline = make_interp_spline(at, section, k=3, t=bank.KNOTS)
        assert bank.matern52_norm(spline, 0.2) == pytest.approx(1, abs=2e-3)


def test_no_function_through_the_same_values_has_a_smaller_norm():
    mean = bank.Bank.read("sim").mean
    points = np.linspace(bank.LOW, bank.HIGH, 81)[:, None]
    gram = Kernel("matern52", 0.2).gram(points, points)
    least = np.sqrt(mean(points[:, 0]) @ np.linalg.solve(gram, mean(points[:, 0])))
    assert 0.9 * bank.matern52_norm(mean, 0.2) < least < bank.matern52_norm(mean, 0.2)


def test_draws_have_the_mean_and_the_range_that_are_claimed():
    one, rng = bank.Bank.read("twin:lab"), np.random.default_rng(0)
    for test in (-0.2, -0.013, 0.1, 0.2999, 0.3):
        drawn = one.draw(test, 20_000, rng)
        assert drawn.mean() == pytest.approx(float(one.mean(test)), abs=5 * drawn.std() / np.sqrt(len(drawn)))
        assert np.ptp(drawn) <= 2 * one.proxy


def test_the_minimum_is_that_of_a_fine_grid():
    for name in ("sim", "twin:lab"):
        mean = bank.Bank.read(name).mean
        lowest, where = bank.minimum(mean)
        fine = mean(np.linspace(bank.LOW, bank.HIGH, 20_001))
        assert lowest <= fine.min()
        assert lowest == pytest.approx(fine.min(), abs=1e-8)
        assert float(mean(where)) == pytest.approx(lowest)
