"""The response to one parameter between the sizes at which it was simulated."""

import numpy as np
import pytest

from s2r_spec.diagnose.simulator.curve import Curve

COORDINATES = np.array([-1.0, -0.3, 0.0, 0.3, 1.0, 2.0])


def test_a_linear_effect_is_linear_and_its_interpolation_has_no_error():
    curve = Curve(COORDINATES, np.outer(COORDINATES, [2.0, -1.0]))
    for c in (-1.4, -0.5, 0.1, 0.7, 2.5):
        assert curve.at(c) == pytest.approx([2.0 * c, -c])
        assert curve.slope(c) == pytest.approx([2.0, -1.0])
        assert curve.bend(c) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_an_effect_with_a_threshold_does_not_overshoot_and_says_what_is_not_known():
    """Nothing slips up to 0.3, and everything at 1."""
    curve = Curve(COORDINATES, np.array([[0.0], [0.0], [0.0], [0.0], [10.0], [10.0]]))
    between = np.array([curve.at(c)[0] for c in np.linspace(-1.0, 2.0, 61)])
    assert between.min() >= 0.0
    assert between.max() <= 10.0 + 1e-9
    assert curve.at(0.15) == pytest.approx([0.0])
    assert abs(curve.bend(0.45)[0]) > 0.9
    assert curve.bend(1.0) == pytest.approx([0.0])


def test_the_slope_is_the_derivative():
    curve = Curve(COORDINATES, np.column_stack([COORDINATES**2, np.tanh(COORDINATES)]))
    for c in (-0.7, 0.2, 1.6, 2.7):
        assert (curve.at(c + 1e-6) - curve.at(c - 1e-6)) / 2e-6 == pytest.approx(curve.slope(c), abs=1e-5)


def test_a_parameter_that_was_never_simulated_does_nothing():
    curve = Curve(np.zeros(1), np.zeros((1, 3)))
    assert curve.at(0.7) == pytest.approx(np.zeros(3))
    assert curve.slope(0.7) == pytest.approx(np.zeros(3))
