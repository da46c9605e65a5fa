"""The forces on the axis over a whole recording."""

import numpy as np

from s2r_emps.laws import lacking_force
from s2r_emps.physics import Physics


def test_dry_friction_explains_what_it_can_at_rest_and_all_of_itself_in_motion():
    v = np.array([0.0, 0.0, 0.0, 0.1, -0.1])
    force = np.array([5.0, 30.0, -30.0, 30.0, -30.0])
    left = lacking_force(np.full(5, 0.12), v, np.zeros(5), force, Physics(coulomb=20.0))
    np.testing.assert_allclose(left, [0.0, -10.0, 10.0, -10.0, 10.0])


def test_what_was_not_recorded_is_not_taken_for_explained():
    gone = np.array([np.nan, 0.12, 0.12])
    still = np.zeros(3)
    lost = np.array([0.0, np.nan, 0.0])
    assert np.isnan(lacking_force(gone, gone - 0.12, still, lost, Physics(cable=1.0))).tolist() == [
        True,
        True,
        False,
    ]
