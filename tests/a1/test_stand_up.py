"""A robot that lies on its belly can stand up, hold the stand, lie down and stand up again, wherever a twin can be."""

import numpy as np
import pytest

from s2r_a1.guard import moves
from s2r_a1.twin.places import NOMINAL, PLACES
from s2r_sim.plant.physics import FallLimits
from tests.a1.steering import LIMP, steer, twin

ROUND = 2_000_000  # ns


def moved(robot, motion, rounds):
    """Lead a robot along a motion; return its last state, the worst error of a joint and the worst tilt [rad]."""
    errors, tilts = [], []
    for tick in range(1, rounds + 1):
        reading = steer(robot, moves.orders(motion, tick * ROUND))
        errors.append(np.abs(reading.q - moves.desired_state(motion, tick * ROUND)[0]).max())
        tilts.append(np.abs(robot.truth().rpy[:2]).max())
    return reading, max(errors), max(tilts)


@pytest.mark.parametrize(
    "place",
    [pytest.param(place, marks=() if place in (NOMINAL, "sand") else pytest.mark.slow) for place in PLACES],
)
def test_it_stands_up_holds_and_lies_down_again(place):
    robot = twin(place=place)
    lying = steer(robot, LIMP, 5)
    assert robot.truth().position[2] < 0.06
    up = moves.STAND_UP // ROUND

    reading, error, tilt = moved(robot, moves.standing_up(lying.q, 0), up + 100)
    standing = robot.truth()
    # What the gains leave under the robot's weight: half a hand below the height of a stand without weight.
    assert moves.STAND_HEIGHT - 0.045 < standing.position[2] < moves.STAND_HEIGHT
    assert np.abs(standing.dq).max() < 0.1
    assert error < 0.3
    assert tilt < 0.1
    assert np.abs(reading.tau).max() < 20.0

    _, error, tilt = moved(robot, moves.lying_down(moves.STANDING, 0), moves.LIE_DOWN // ROUND)
    assert error < 0.3
    assert tilt < 0.1
    reading = steer(robot, moves.DAMPED, 250)
    resting = robot.truth()
    assert resting.position[2] < 0.11
    assert np.abs(resting.dq).max() < 1.0  # it sinks onto its belly, braked

    if place == NOMINAL:
        moved(robot, moves.standing_up(reading.q, 0), up)
        assert robot.truth().position[2] > FallLimits().height


def test_a_robot_that_lies_stays_as_it_is():
    robot = twin(place="sand", noise=False)
    before = steer(robot, LIMP)
    after = steer(robot, LIMP, 200)
    np.testing.assert_allclose(after.q, before.q, atol=0.02)
    assert np.abs(after.dq).max() < 0.05


def test_free_joints_let_a_standing_robot_drop():
    robot = twin("mode=all:0@1100-", noise=False)
    lying = steer(robot, LIMP)
    moved(robot, moves.standing_up(lying.q, 0), 1050)
    assert robot.truth().position[2] > 0.23
    moved(robot, moves.standing_up(lying.q, 0), 250)
    assert robot.truth().position[2] < 0.12
