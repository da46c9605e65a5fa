"""What a set leaves: its size, in units of scatter, background and laws."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_spec.diagnose.inference.misfit import Misfit, by_chance, energies
from tests.diagnose.inference.test_prediction import EFFECTS, machine, nominal, signatures


def squares(data, value):
    return np.full(sum(len(one.parts) for one in data), value)


def test_a_set_that_leaves_a_quarter_of_the_logarithm_is_the_last_one_that_counts():
    data = nominal(tests=4)
    chance = np.tile([by_chance(4.0 * size) for size in data[0].effective], 4)
    for left, rejected in ((0.0, False), (0.24, False), (0.26, True), (1.0, True)):
        before = 1.0 + chance
        found = Misfit.of(data, np.exp(before), np.exp(left * before))
        assert found.shown == pytest.approx(1.0)
        assert found.left == pytest.approx(left)
        assert found.rejected is rejected
    small = Misfit.of(data, squares(data, 1.05), squares(data, 1.05))
    assert small.left == pytest.approx(1.0)
    assert not small.rejected


def test_scatter_alone_gives_no_misfit_on_average():
    rng = np.random.default_rng(0)
    for degrees in (3.0, 40.0):
        drawn = rng.chisquare(degrees, 20_000) / degrees
        assert by_chance(degrees) == pytest.approx(np.log(np.maximum(drawn, 1.0)).mean(), rel=0.05)


def test_less_than_scatter_is_no_misfit():
    data = nominal(tests=4)
    found = Misfit.of(data, squares(data, 0.5), squares(data, 0.1))
    assert (found.shown, found.left, found.rejected) == (0.0, 0.0, False)


def test_innovations_reject_nothing():
    data = [
        replace(one, parts=tuple(((name, "innovation"), places) for (name, _), places in one.parts))
        for one in nominal(tests=4)
    ]
    found = Misfit.of(data, squares(data, 50.0), squares(data, 50.0))
    assert (found.shown, found.left) == (0.0, 0.0)


def test_a_tenth_of_a_response_may_be_left():
    """The machine has another law of its first effect: what differs is a tenth of its response, in another shape."""
    truth, tests = np.array([1.5, 0.0, 0.0, 0.0]), 4
    shape = signatures(tests)
    other = 0.1 * 1.5 * np.linalg.norm(shape[:, 0]) / np.linalg.norm(shape[:, 1]) * shape[:, 1]
    data = machine(truth, tests=tests, other=other, scatter=0.01)
    background = [np.zeros(one.observed.size) for one in data]
    data = [replace(one, noise=np.full(one.observed.size, 1e-4)) for one in data]
    assert energies(data, background, truth).mean() < 2.0
    assert energies(data, background, np.zeros(EFFECTS)).mean() > 100.0
