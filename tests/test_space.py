"""Points of the test space."""

import numpy as np

from s2r_spec.space import Space


def test_ends_and_zero_are_met_exactly():
    space = Space.of({"turn": (-0.6, 0.6), "load": (0.1, 0.7), "slope": (-0.2, 0.3)})
    # The middle of the first is −1.1e-16 otherwise, and is printed so.
    unit = np.array([[0.0, 0.0, 0.0], [(0.6 - 1e-16) / 1.2, 0.5, 0.4], [1.0, 1.0, 1.0]])
    low, middle, high = space.at(unit)
    np.testing.assert_array_equal(low, space.lower)
    np.testing.assert_array_equal(high, space.upper)
    assert middle[0] == middle[2] == 0.0
    np.testing.assert_allclose(middle[1], 0.4)
    assert space.at(np.array([0.5 + 1e-9, 0.0, 0.0]))[0] > 0.0
