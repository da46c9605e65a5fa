import numpy as np
import pytest

from s2r_spec.trace.instants import instant

EPOCH = 1718000000.0


@pytest.mark.parametrize(
    ("times", "t", "text"),
    [
        (np.arange(10) / 10, 0.2, "0.2 s"),
        (np.arange(10) / 10, 0.30000000000000004, "0.3 s"),
        (np.arange(100) / 1000, 0.012, "0.012 s"),
        (np.arange(9) / 30, 1 / 30, "0.0333 s"),
        ([0, 0.1013, 0.1996], 0.1013, "0.1013 s"),
        (np.arange(0, 900, 60), 120, "120 s"),
        (np.arange(5) * 1e-6 + 7, 7.000002, "7.000002 s"),
        (np.arange(5) * 1e-14, 2e-14, "2e-14 s"),
        ([4.25], 4.25, "4.25 s"),
        ([-0.2, -0.1, 0.0], -0.1, "-0.1 s"),
        ([-0.1, 1e-17, 0.1], -1e-17, "0 s"),
        ([0, 1], np.inf, "inf s"),
        (EPOCH + np.arange(0, 4, 0.001), EPOCH + 1.512, "1.512 s after the first sample (1718000001.512 s)"),
        (EPOCH + np.arange(4), EPOCH, "0 s after the first sample (1718000000 s)"),
        (EPOCH + np.arange(0, 1, 0.25), EPOCH + 0.3, "0.3 s after the first sample (1718000000.3 s)"),
    ],
)
def test_an_instant_is_printed_to_the_sample(times, t, text):
    assert instant(times, t) == text


@pytest.mark.parametrize("start", [0.0, 12.7, EPOCH, EPOCH + 0.123456])
@pytest.mark.parametrize("period", [1e-5, 1.0003e-3, 0.02, 1 / 3, 7.0])
def test_neighbouring_samples_print_differently(start, period):
    rng = np.random.default_rng(0)
    times = start + period * np.cumsum(rng.uniform(0.5, 1.5, 50))
    assert len({instant(times, t) for t in times}) == 50


def test_stamps_around_the_instant_are_enough():
    times = EPOCH + np.arange(0, 4, 0.01)
    assert instant([times[0], *times[70:74]], times[72]) == instant(times, times[72])
