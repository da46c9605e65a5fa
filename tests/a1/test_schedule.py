"""Which command holds when."""

import pytest

from s2r_a1.schedule import Schedule
from s2r_sim.controller.gains import RATE, Gains
from s2r_sim.controller.gait import Gait
from s2r_sim.plant.noise import Noise, draw
from s2r_sim.robot.signals import VelocityCommand

PERIOD = Gait.of(Gains()).period


@pytest.mark.parametrize("seed", range(5))
def test_the_gait_has_the_seed_s_phase_at_the_command_as_in_the_simulator(seed):
    schedule = Schedule.of(VelocityCommand(0.2), seed, 100, Gains())
    assert schedule.trot % PERIOD == draw(Noise(), seed, 0, PERIOD).phase
    assert 1.2 * RATE <= schedule.trot < 1.2 * RATE + PERIOD


def test_the_command_steps_at_zero_holds_to_the_end_and_ramps_down():
    schedule = Schedule.of(VelocityCommand(0.2, -0.1, 0.4), 0, 100, Gains())
    assert schedule.at(-1) == VelocityCommand()
    assert schedule.at(0) == schedule.at(100) == VelocityCommand(0.2, -0.1, 0.4)
    halfway = schedule.at(100 + RATE // 4)
    assert halfway == pytest.approx((0.1, -0.05, 0.2))
    assert schedule.at(100 + RATE // 2) == VelocityCommand()
    assert not schedule.is_over(100 + RATE // 2 - 1)
    assert schedule.is_over(100 + RATE // 2)


def test_a_test_that_is_cut_ramps_down_from_there():
    schedule = Schedule.of(VelocityCommand(0.2), 0, 100, Gains()).cut(40)
    assert schedule.at(40) == VelocityCommand(0.2)
    assert 0.0 < schedule.at(60).vx < 0.2
    assert schedule.cut(70) == schedule
