"""The frequency at which a model fails."""

import numpy as np
import pytest

from s2r_spec.diagnose.residuals.left import peak_frequency


def test_the_frequency_of_a_resonance_is_found_in_noise_and_beside_a_constant():
    t, random = 0.005 * np.arange(400), np.random.default_rng(0)
    series = [
        3.0 + np.sin(2 * np.pi * 6.3 * t + phase) + random.normal(size=t.size) for phase in (0.0, 1.0, 2.5)
    ]
    assert peak_frequency(series, 0.005) == pytest.approx(6.3, abs=0.2)


def test_nothing_is_left_of_short_missing_and_constant_series():
    assert peak_frequency([np.zeros(5), np.full(100, np.nan)], 0.01) is None
    assert peak_frequency([np.ones(100)], 0.01) is None
