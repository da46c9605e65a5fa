"""The response to one parameter between the sizes at which it was simulated."""

import numpy as np
import pytest

from s2r_spec.diagnose.simulator.curve import Curves, ResponseCurve, Turn

COORDINATES = np.array([-1.0, -0.3, 0.0, 0.3, 1.0, 2.0])


def test_a_linear_effect_is_linear_and_its_interpolation_has_no_error():
    curve = ResponseCurve(COORDINATES, np.outer(COORDINATES, [2.0, -1.0]))
    for c in (-1.4, -0.5, 0.1, 0.7, 2.5):
        assert curve.at(c) == pytest.approx([2.0 * c, -c])
        assert curve.slope(c) == pytest.approx([2.0, -1.0])
        assert curve.bend(c) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_an_effect_with_a_threshold_does_not_overshoot_and_says_what_is_not_known():
    """Nothing slips up to 0.3, and everything at 1."""
    curve = ResponseCurve(COORDINATES, np.array([[0.0], [0.0], [0.0], [0.0], [10.0], [10.0]]))
    between = np.array([curve.at(c)[0] for c in np.linspace(-1.0, 2.0, 61)])
    assert between.min() >= 0.0
    assert between.max() <= 10.0 + 1e-9
    assert curve.at(0.15) == pytest.approx([0.0])
    assert abs(curve.bend(0.45)[0]) > 0.9
    assert curve.bend(1.0) == pytest.approx([0.0])


def test_the_slope_is_the_derivative():
    curve = ResponseCurve(COORDINATES, np.column_stack([COORDINATES**2, np.tanh(COORDINATES)]))
    for c in (-0.7, 0.2, 1.6, 2.7):
        assert (curve.at(c + 1e-6) - curve.at(c - 1e-6)) / 2e-6 == pytest.approx(curve.slope(c), abs=1e-5)


def test_a_parameter_that_was_never_simulated_does_nothing():
    curve = ResponseCurve(np.zeros(1), np.zeros((1, 3)))
    assert curve.at(0.7) == pytest.approx(np.zeros(3))
    assert curve.slope(0.7) == pytest.approx(np.zeros(3))


def ripple(angle):
    """Response to the phase of a ripple, which is nominal at 0: half a turn is a coordinate of 1."""
    x = np.pi * np.asarray(angle)[..., None]
    return np.concatenate([np.cos(x) - 1.0, np.sin(x), 0.3 * (np.cos(2.0 * x) - 1.0)], axis=-1)


QUARTERS = np.array([-1.0, -0.5, 0.0, 0.5])


def test_the_phase_of_a_ripple_is_known_at_every_angle_from_its_quarters():
    curve = Turn(QUARTERS, ripple(QUARTERS))
    for c in (-3.1, -0.9, -0.2, 0.3, 0.99, 1.01, 1.4):
        assert curve.at(c) == pytest.approx(ripple(c))
        assert curve.slope(c) == pytest.approx((ripple(c + 1e-6) - ripple(c - 1e-6)) / 2e-6, abs=1e-5)
        assert curve.bend(c)[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert curve.bend(0.5) == pytest.approx(np.zeros(3), abs=1e-12)
    assert abs(curve.bend(0.25)[2]) == pytest.approx(0.3)


def test_an_angle_at_which_the_machine_fell_is_left_out():
    rest = np.delete(QUARTERS, 1)
    assert Turn(rest, ripple(rest)[:, :2]).at(-0.5) == pytest.approx(ripple(-0.5)[:2])
    assert Turn(np.zeros(1), np.zeros((1, 2))).at(0.3) == pytest.approx(np.zeros(2))


def test_curves_together_are_each_alone():
    random = np.random.default_rng(5)
    ends, angles = np.array([-1.0, -0.2, 0.0, 0.5, 2.0]), np.array([-0.5, 0.0, 0.5, 1.0])
    each = (
        ResponseCurve(ends, random.normal(size=(5, 7))),
        Turn(angles, random.normal(size=(4, 7))),
        ResponseCurve(np.zeros(1), np.zeros((1, 7))),
        ResponseCurve(ends[1:], random.normal(size=(4, 7))),
    )
    together = Curves(each)
    for theta in 2.0 * random.normal(size=(20, 4)):
        alone = [(one.at(x), one.slope(x)) for one, x in zip(each, theta.tolist(), strict=True)]
        assert together.at(theta) == pytest.approx(np.array([at for at, _ in alone]), rel=1e-12)
        assert together.slope(theta) == pytest.approx(np.array([slope for _, slope in alone]), rel=1e-12)
