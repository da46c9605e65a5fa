"""Responses that were measured with errors."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.observation import share_of_signal


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
