"""Effects of the turtlebot: they compose in any order, do nothing at nominal, and do what they say."""

import random

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.backend import Backend, HasEffects
from s2r_spec.errors import UsageError
from s2r_turtlebot import TurtlebotBackend
from s2r_turtlebot.effects import CATALOGUE, TurtlebotWithEffects, turtlebot
from tests.errors import naming

ROBOT = turtlebot()
ROUND = {"ox": 0.0, "oy": 0.1}
"""A test in which the robot turns."""


def between(effect, part):
    """Return values on the way from nominal to the end of the range that is farther away."""
    return {
        p.name: p.nominal + part * (max(p.low, p.high, key=lambda end: abs(end - p.nominal)) - p.nominal)
        for p in effect.parameters
    }


def same(a, b):
    return all(a[name].tobytes() == b[name].tobytes() for name in a.channels)


def test_behind_the_name_is_the_tutorial_robot_with_a_catalogue():
    assert s2r.load_backend("turtlebot") == ROBOT
    assert isinstance(ROBOT, Backend)
    assert isinstance(ROBOT, HasEffects)
    assert ROBOT.effects() is CATALOGUE
    assert len(CATALOGUE) == 9
    assert same(ROBOT.rollout(ROUND, 3), TurtlebotBackend().rollout(ROUND, 3))
    for effect in CATALOGUE:
        assert effect.physics.endswith(".")
        assert all(p.low <= p.nominal <= p.high and p.prior for p in effect.parameters)


def test_all_effects_at_nominal_change_no_bit():
    added = ROBOT.with_effects({e.name: {p.name: p.nominal for p in e.parameters} for e in CATALOGUE})
    assert same(ROBOT.rollout(ROUND, 4), added.rollout(ROUND, 4))
    assert added.model_hash == ROBOT.model_hash


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_every_effect_changes_the_trace_and_the_hash_and_vanishes_with_its_size(effect):
    nominal = ROBOT.rollout(ROUND, 4)
    gone = [
        np.abs(
            ROBOT.with_effects({effect.name: between(effect, part)}).rollout(ROUND, 4)["y"] - nominal["y"]
        ).max()
        for part in (0.9, 1e-6)
    ]
    assert gone[0] > 1e-3
    assert gone[1] < 1e-4
    assert ROBOT.with_effects({effect.name: between(effect, 0.9)}).model_hash != ROBOT.model_hash


def test_order_is_irrelevant():
    effects = list(CATALOGUE)
    traces = []
    for _ in range(2):
        random.Random(1).shuffle(effects)
        robot = ROBOT
        for effect in effects:
            robot = robot.with_effects({effect.name: between(effect, 0.2)})
        traces.append(robot.rollout(ROUND, 2))
        effects.reverse()
    assert same(*traces)


def test_a_rollout_forgets_the_one_before():
    late = ROBOT.with_effects({"latency": {"delay": 0.1}, "motor_lag": {"time": 0.1}})
    first = late.rollout(ROUND, 2)
    late.rollout({"ox": 0.2, "oy": 0.0}, 3)
    assert same(first, late.rollout(ROUND, 2))


def test_the_name_says_what_was_added():
    worn = ROBOT.with_effects({"latency": {"delay": 0.1}})
    assert worn.name == "turtlebot:latency.delay=0.1"
    assert turtlebot("latency.delay=0.1") == worn
    assert worn.with_duration(2.0) == TurtlebotWithEffects(duration=2.0, added=worn.added)


@pytest.mark.parametrize(
    ("options", "facts"),
    [
        ("fast", ["'turtlebot'", "'fast'"]),
        ("latncy.delay=1", ["'turtlebot'", "'latncy'", "did you mean 'latency'"]),
        ("latency.delay=1", ["latency", "delay = 1 s", "[0, 0.3] s"]),
    ],
)
def test_a_bad_option_gets_a_sentence(options, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        turtlebot(options)


def test_larger_wheels_arrive_earlier():
    def arrival(robot):
        return np.argmax(robot.rollout({}, 0)["d_goal"] < 0.25)

    assert arrival(ROBOT.with_effects({"wheel_radius": {"factor": 1.2}})) < 0.9 * arrival(ROBOT)


def test_a_command_arrives_after_the_delay():
    late = ROBOT.with_effects({"latency": {"delay": 0.05}})  # two and a half ticks
    part = late._body(0)[1]
    assert [part(float(k), 0.0)[0] for k in range(5)] == pytest.approx([0.0, 0.0, 0.0, 0.5, 1.5])


@pytest.mark.parametrize("ticks", [1.0, 2.5, 6.0, 7.25, 15.0])
def test_nothing_arrives_before_the_delay_and_everything_after_it(ticks):
    """A pulse of one tick: what arrives covers the shares of the two ticks in which it does."""
    delay = ticks * ROBOT.constants.step
    part = ROBOT.with_effects({"latency": {"delay": delay}})._body(0)[1]
    arrived = np.array([part(float(k == 0), float(k == 3)) for k in range(24)])
    for column, sent in ((0, 0), (1, 3)):
        first, share = sent + int(ticks), ticks % 1
        expected = np.zeros(24)
        expected[first], expected[first + 1] = 1.0 - share, share
        np.testing.assert_allclose(arrived[:, column], expected, atol=1e-9)


def test_a_late_robot_stands_until_the_first_command_has_arrived():
    late = ROBOT.with_effects({"latency": {"delay": 0.12}}).rollout({}, 5)
    at_rest = late.times <= 0.12 + 1e-9
    assert late["v"][1] > 0.3  # it was told to drive at once
    assert set(late["x"][at_rest]) == {-0.8}
    assert late["x"][at_rest.sum()] > -0.8


def test_a_dead_time_is_not_what_a_lag_does_at_the_start():
    late, slow = (
        ROBOT.with_effects(e).rollout({}, 5)
        for e in ({"latency": {"delay": 0.12}}, {"motor_lag": {"time": 0.12}})
    )
    assert late["x"][6] == -0.8
    assert slow["x"][6] > -0.79


@pytest.mark.parametrize(
    "alone",
    [
        {"latency": {"jitter": 0.3}},
        {"speed_limit": {"own": 1.0}},
        {"motor_lag": {"dead": 0.5}},
        {"turning_slip": {"wheel": 1.0, "power": 1.0}},
    ],
)
def test_a_dependent_parameter_does_nothing_by_itself(alone):
    assert same(ROBOT.rollout(ROUND, 4), ROBOT.with_effects(alone).rollout(ROUND, 4))


def test_a_jitter_varies_the_delay_around_its_mean():
    late = ROBOT.with_effects({"latency": {"delay": 0.1, "jitter": 0.2}})  # 5 ± 1 ticks
    part = late._body(3)[1]
    ages = np.array([k - part(float(k), 0.0)[0] for k in range(1000)])[20:]
    assert (ages.mean(), ages.std()) == pytest.approx((5.0, 1.0), abs=0.1)
    assert same(late.rollout(ROUND, 3), late.rollout(ROUND, 3))
    assert not same(late.rollout(ROUND, 3), late.rollout(ROUND, 4))


@pytest.mark.parametrize("dead", [0.0, 0.4, 0.8])
def test_a_part_of_a_lag_may_be_dead_time(dead):
    """The speed after a step: none for 0.2 s times this part, then that of a first order; on average it is as late."""
    part = ROBOT.with_effects({"motor_lag": {"time": 0.2, "dead": dead}})._body(0)[1]
    speeds = np.array([part(1.0, 0.0)[0] for _ in range(500)])
    assert np.flatnonzero(speeds)[0] == round(10 * dead)
    assert 0.02 * (1.0 - speeds).sum() == pytest.approx(0.2, abs=0.011)


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0])
def test_slip_may_grow_with_a_power_of_the_speed_of_the_robot_or_of_its_wheels(power):
    def rate(speed, turn, wheel):
        slip = {"coefficient": 1.0, "power": power, "wheel": wheel}
        return turn / ROBOT.with_effects({"turning_slip": slip})._body(0)[1](speed, turn)[1] - 1.0

    assert rate(0.4, 1.0, 0.0) == pytest.approx(0.4)
    assert rate(0.8, 1.0, 0.0) == pytest.approx(0.8 * 2.0**power)
    assert rate(0.0, 5.0, 0.0) == 0.0
    assert rate(0.0, 5.0, 1.0) == pytest.approx(0.4)  # wheels at 0.4 m/s turn on the spot


@pytest.mark.parametrize(("own", "wheels"), [(0.0, (0.1, 0.3)), (0.5, (0.15, 0.3)), (1.0, (0.2, 0.3))])
def test_a_limit_may_hold_for_both_wheels_together_or_for_each(own, wheels):
    """The left wheel is commanded 0.2 m/s and the right one 0.6 m/s."""
    v, w = ROBOT.with_effects({"speed_limit": {"speed": 0.3, "own": own}})._body(0)[1](0.4, 0.4 / 0.16)
    assert (v - 0.08 * w, v + 0.08 * w) == pytest.approx(wheels)


def test_whoever_believes_to_be_on_the_left_drives_on_the_right():
    trace = ROBOT.with_effects({"position_bias": {"left": 0.1}}).rollout({}, 0)
    assert trace["y"][-1] == pytest.approx(ROBOT.rollout({}, 0)["y"][-1] - 0.1, abs=0.01)
