"""What a response shows beyond the scatter of its runs."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.calibration import share_of_signal, straightened

SIZES = np.array([-2.0, -1.0, -0.3, 0.3, 1.0, 2.0])
SIGNATURE = np.sin(np.arange(40.0))


def test_a_response_without_scatter_goes_through_every_point():
    values = np.outer(np.tanh(3.0 * SIZES), SIGNATURE)
    found, variance = straightened(SIZES, values, np.zeros_like(values))
    assert found == pytest.approx(values)
    assert (variance == 0.0).all()


def test_scatter_is_no_curve():
    """The error at a small size is that of the line through all points, and is known."""
    rng, errors, known = np.random.default_rng(1), [], []
    truth, noise = np.outer(SIZES, SIGNATURE), 0.5
    for _ in range(200):
        values = truth + noise * rng.normal(size=truth.shape)
        found, variance = straightened(SIZES, values, np.full_like(values, noise**2))
        errors.append(found - truth)
        known.append(variance)
    small = np.abs(SIZES) < 0.5
    mean = np.mean(np.square(errors)[:, small])
    assert mean < np.mean(np.array(known)[:, small]) < 0.1 * noise**2
    assert np.abs(np.mean(errors, axis=0)).max() < 0.15


def test_a_wild_point_does_not_bend_the_line_at_small_sizes():
    values, variance = np.outer(SIZES, SIGNATURE), np.full((6, 40), 0.01)
    values[-1] += 100.0 * np.random.default_rng(2).normal(size=40)
    variance[-1] = 100.0**2
    found, left = straightened(SIZES, values, variance)
    assert (left >= 0.0).all()
    assert found[:5] == pytest.approx(np.outer(SIZES[:5], SIGNATURE), abs=0.3)


def test_a_fit_to_calibrated_responses_is_right_on_average():
    rng = np.random.default_rng(1)
    true, raw, kept = 0.15 * rng.normal(size=50), [], []
    for _ in range(400):
        measured, data = true + 0.2 * rng.normal(size=50), true + 0.05 * rng.normal(size=50)
        own = share_of_signal(measured[None], np.full((1, 50), 0.04)) * measured
        for found, response in ((raw, measured), (kept, own)):
            found.append((response @ data, response @ response))
    slopes = [np.sum(each, axis=0)[0] / np.sum(each, axis=0)[1] for each in (raw, kept)]
    assert slopes[0] < 0.5
    assert slopes[1] == pytest.approx(1.0, abs=0.2)


def test_a_response_without_noise_is_whole_and_one_that_is_all_noise_is_none():
    measured = np.linspace(-1.0, 1.0, 20).reshape(2, 10)
    assert share_of_signal(measured, np.zeros((2, 10))) == 1.0
    assert share_of_signal(measured, np.ones((2, 10))) == 0.0
    assert share_of_signal(np.zeros((2, 10)), np.ones((2, 10))) == 1.0
