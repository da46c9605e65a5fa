"""The filter of the residuals is the Butterworth filter that it says it is."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from s2r_emps.noise import Noise
from s2r_emps.physics import RATE
from s2r_emps.residuals import CUTOFF, EDGE, _smooth


@pytest.mark.parametrize("size", [3 * EDGE + 1, 2500, 2501, 24841])
def test_the_filter_is_that_of_scipy_forth_and_back_where_residuals_are_given(size):
    """To less than the encoder scatters [m]; the ends, of which filters know nothing, are cut off."""
    rng = np.random.default_rng(size)
    values = 1e-3 * np.cumsum(rng.normal(size=size)) + np.linspace(0.0, 0.3, size)
    expected = sosfiltfilt(butter(2, CUTOFF, fs=RATE, output="sos"), values)
    inner = slice(EDGE, -EDGE)
    np.testing.assert_allclose(_smooth(values)[inner], expected[inner], rtol=0, atol=Noise().encoder)
