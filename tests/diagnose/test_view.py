"""What is seen test by test, and what through a few functions of the test."""

import numpy as np
import pytest

from s2r_spec.diagnose.how_far import how_far
from s2r_spec.diagnose.joint import Joint, seen_through
from s2r_spec.diagnose.layout import SHOTS, Layout
from s2r_spec.diagnose.prepare import TREND, _trend
from s2r_spec.space import Axis, Space

SPACE = Space((Axis("v", 0.0, 1.0, "m/s"),))
BANK = [{"v": v} for v in np.linspace(0, 1, 7)]
TESTS = [{"v": v} for v in np.linspace(0.02, 0.98, 15)]


class Quiet:
    """Signatures of a simulator that scatters a little."""

    noise = 0.01 * np.eye(3)


def trend(means):
    layout = Layout.of(SPACE, BANK, TESTS)
    return _trend(layout, layout.each(1.0), means, Quiet)


def test_a_gap_with_a_trend_is_held_by_a_few_functions():
    v = np.array([test["v"] for test in TESTS])
    assert trend(np.stack([5 + v, 3 * v, v**2], axis=1)) > 0.95


def test_a_limit_that_is_reached_at_one_test_is_not():
    means = np.zeros((15, 3))
    means[14] = 20.0
    assert trend(means) < TREND


def test_each_test_by_itself_scatters_as_its_own_rollouts_do():
    layout = Layout.of(SPACE, BANK, [*TESTS, TESTS[0], TESTS[0]])
    each = layout.each(2.0)
    assert each.project.shape == (15, 15)
    np.testing.assert_allclose(np.diag(each.scatter)[:2], [2 / 3 + 1 / SHOTS, 2 + 1 / SHOTS])
    np.testing.assert_allclose(each.through, layout.interpolate)
    data = np.arange(30.0).reshape(15, 2)
    np.testing.assert_allclose(each.level(data), (data**2).mean(axis=0))


def test_a_fit_seen_through_functions_is_that_of_the_functions():
    rng = np.random.default_rng(0)
    rest, jacobian, project = rng.normal(size=(15, 2)), rng.normal(size=(4, 15, 2)), rng.normal(size=(3, 15))
    seen = seen_through(
        Joint(np.zeros(4), rest, jacobian, 1.0, 2.0), project, np.ones((3, 2)), np.zeros((0, 3, 2))
    )
    np.testing.assert_allclose(seen.rest, project @ rest)
    np.testing.assert_allclose(seen.jacobian[2], project @ jacobian[2])
    assert seen.misfit == pytest.approx(((project @ rest) ** 2).mean())


def far(named, tuned):
    real = np.full(9, 1.0)
    tests = [{"v": k / 9} for k in range(9)]
    return how_far(real, np.zeros(9), real - named, real - tuned, tests, 0.01, 0.05, 3, "m")


def test_a_gap_is_open_only_if_a_little_of_everything_does_not_close_it_either():
    assert far(named=0.7, tuned=0.1).open is False
    assert far(named=0.7, tuned=0.6).open is True
    assert far(named=0.1, tuned=0.6).open is False
    assert far(named=0.7, tuned=0.1).gone is True
