"""Clock, swing polynomial and foothold."""

import numpy as np
import pytest

from s2r_sim.controller.foot_task import raibert, swing
from s2r_sim.controller.gains import Gains
from s2r_sim.controller.gait import Gait


def test_diagonal_legs_swing_together_and_two_feet_always_stand():
    gait = Gait.of(Gains())
    for tick in range(2 * gait.period):
        fr, fl, rr, rl = gait.progress(tick)
        assert fr == rl
        assert fl == rr
        assert fr is None or fl is None


def test_each_leg_stands_for_the_duty_part_of_the_period():
    gait = Gait.of(Gains())
    standing = sum(gait.progress(tick)[0] is None for tick in range(gait.period))
    assert standing / gait.period == pytest.approx(Gains().duty)
    assert gait.stance_time + gait.swing_time == pytest.approx(Gains().period)


START, END, HEIGHT, DURATION = (0.1, -0.2, 0.02), (0.2, -0.15, 0.018), 0.06, 0.18


def test_a_swing_starts_and_ends_at_rest_where_it_should():
    for s, place in ((0.0, START), (1.0, END)):
        target = swing(START, END, HEIGHT, s, DURATION)
        np.testing.assert_allclose(target.position, place, atol=1e-15)
        np.testing.assert_allclose(target.velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(target.acceleration, 0.0, atol=1e-12)


def test_a_swing_rises_to_its_height_half_way():
    assert swing(START, END, HEIGHT, 0.5, DURATION).position[2] == pytest.approx(0.019 + HEIGHT)


@pytest.mark.parametrize("s", [0.1, 0.37, 0.5, 0.9])
def test_velocity_and_acceleration_are_the_derivatives_of_position(s):
    h = 1e-5
    before, here, after = (swing(START, END, HEIGHT, s + d, DURATION) for d in (-h, 0.0, h))
    step = 2 * h * DURATION
    np.testing.assert_allclose(np.subtract(after.position, before.position) / step, here.velocity, atol=1e-7)
    np.testing.assert_allclose(
        np.subtract(after.velocity, before.velocity) / step, here.acceleration, atol=1e-5
    )


def test_at_the_commanded_speed_the_foot_lands_below_the_hip_at_mid_stance():
    x, y = raibert((1.0, 2.0), (0.3, 0.0), (0.3, 0.0), time_to_go=0.1, stance_time=0.2, gain=0.1)
    assert (x, y) == (pytest.approx(1.0 + 0.3 * 0.2), 2.0)


def test_too_fast_means_a_foothold_further_ahead():
    slow = raibert((0.0, 0.0), (0.3, 0.0), (0.3, 0.0), 0.0, 0.2, 0.1)
    fast = raibert((0.0, 0.0), (0.3, 0.0), (0.2, 0.0), 0.0, 0.2, 0.1)
    assert fast[0] - slow[0] == pytest.approx(0.1 * 0.1)
