"""The closed loop: it trots, carries its weight, follows the command, and says when it falls."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from s2r_sim import SimBackend
from s2r_sim.controller.gains import Gains
from s2r_sim.controller.trot import Controller, Memory
from s2r_sim.plant.noise import Noise
from s2r_sim.robot.constants import A1
from s2r_sim.robot.signals import RobotState, VelocityCommand
from s2r_sim.settings import Settings

QUIET = SimBackend(noise=Noise.off())


@cache
def walk(**test):
    """Return two seconds of a walk; several tests look at the same one."""
    return QUIET.with_duration(2.0).rollout(test, seed=0)


@pytest.mark.parametrize("vd", [-0.2, 0.0, 0.15, 0.3])
def test_it_follows_the_command(vd):
    trace = walk(vd=vd)
    v = trace["vx"]
    direction = 1.0 if vd >= v[0] else -1.0
    assert trace.failure is None
    assert trace.meta["qp_failures"] == 0
    assert ((v - vd) * direction).max() <= 0.005
    assert np.abs(v - vd)[trace.times >= 0.5].max() <= 0.03


@pytest.mark.parametrize("vd", [-0.5, 0.5])
def test_it_stays_up_at_the_ends_of_its_range(vd):
    trace = walk(vd=vd)
    assert trace.failure is None
    assert trace["vx"][-1] == pytest.approx(vd, abs=0.05)


@pytest.mark.parametrize(("name", "channel", "value"), [("vy", "vy", 0.15), ("wz", "wz", 0.4)])
def test_it_follows_sideways_and_turning_commands(name, channel, value):
    trace = walk(**{name: value})
    assert trace.failure is None
    assert trace[channel][trace.times >= 1.2].mean() == pytest.approx(value, abs=0.05)


def test_in_steady_trot_the_feet_carry_the_weight():
    trace = walk(vd=0.3)
    # Whole gait periods, so that the vertical momentum at both ends is the same.
    vertical = trace["foot_force"][(trace.times >= 1.2) & (trace.times < 2.0), 2::3]
    assert vertical.sum(axis=1).mean() == pytest.approx(A1.mass * 9.81, rel=0.02)


def test_swing_feet_leave_the_ground_and_stance_feet_push():
    trace = walk(vd=0.3)
    stands, vertical = trace["stance"] == 1.0, trace["foot_force"][:, 2::3]
    assert np.mean(vertical[~stands] == 0.0) > 0.85
    assert np.mean(vertical[stands] > 2.0) > 0.9


def test_foot_channels_are_those_of_feet_on_the_ground():
    trace = walk(vd=0.3, wz=0.3)
    position, velocity = trace["foot_position"], trace["foot_velocity"]
    change = np.gradient(position, trace.times, axis=0)
    assert np.abs(change - velocity)[1:-1].mean() < 0.03 * np.abs(velocity).mean()
    touching = position[:, 2::3][trace["contact"] == 1.0]
    assert A1.foot_radius - 0.002 < touching.min() < touching.max() < A1.foot_radius + 0.001


def test_the_qp_predicts_how_the_base_accelerates():
    trace = walk(vd=0.3, wz=0.3)
    late = trace.times >= 0.5
    sideways = np.gradient(trace["vy"], trace.times) + np.gradient(trace["yaw"], trace.times) * trace["vx"]
    assert np.corrcoef(sideways[late], trace["acc_pred"][late, 1])[0, 1] > 0.95
    forward = np.gradient(trace["vx"], trace.times) - np.gradient(trace["yaw"], trace.times) * trace["vy"]
    assert abs((forward - trace["acc_pred"][:, 0])[late].mean()) < 0.15


def test_the_two_forms_of_the_qp_make_the_same_trot():
    full = replace(QUIET, settings=Settings(form="full")).with_duration(1.0).rollout({"vd": 0.3}, seed=0)
    condensed = walk(vd=0.3)["vx"][: len(full)]
    assert np.abs(full["vx"] - condensed).max() < 1e-3


def test_a_strong_push_ends_in_a_marked_fall():
    trace = SimBackend(duration=3.0).rollout({"vd": 0.1, "push": 50.0, "push_time": 0.2}, seed=1)
    assert trace.failure == "fall"
    assert 0.2 < trace.duration < 3.0
    assert trace["fallen"].tolist() == [0.0] * (len(trace) - 1) + [1.0]


@pytest.mark.parametrize(
    ("towards", "channel", "sign"), [(90.0, "vy", 1), (-90.0, "vy", -1), (0.0, "vx", 1), (180.0, "vx", -1)]
)
def test_a_weak_push_is_survived_and_goes_where_it_should(towards, channel, sign):
    trace = QUIET.rollout({"push": 3.0, "push_towards": towards, "push_time": 0.5}, seed=0)
    assert trace.failure is None
    around = slice(round(0.5 * 500), round(0.6 * 500))
    assert (sign * trace[channel][around]).max() > 0.1


def test_after_failed_qps_the_last_forces_are_held_and_then_the_joints_brake():
    gains = Gains()
    controller = Controller(A1, gains)
    controller.restore(Memory())
    standing = RobotState(
        np.concatenate([[0.0, 0.0, 0.28], np.zeros(9), [0.0, 0.863, -1.726] * 4, np.zeros(12)])
    )
    good = controller.tick(standing, VelocityCommand())
    controller._qp = _Unsolvable()
    held = [controller.tick(standing, VelocityCommand()) for _ in range(gains.hold_ticks)]
    braking = controller.tick(standing, VelocityCommand())
    assert good.solution is not None
    for tick in held:
        assert tick.solution is None
        np.testing.assert_allclose(tick.motors.tau, good.motors.tau, atol=0.5)
    assert not braking.motors.tau.any()
    assert not braking.motors.kp.any()
    assert (braking.motors.kd == gains.kd_damping).all()


def test_after_skipped_ticks_gait_and_reference_are_where_they_would_have_been():
    standing = RobotState(
        np.concatenate([[0.0, 0.0, 0.28], np.zeros(9), [0.0, 0.863, -1.726] * 4, np.zeros(12)])
    )
    command = VelocityCommand(0.2, 0.1, 0.3)
    slow, swift = Controller(A1, Gains()), Controller(A1, Gains())
    for controller in (slow, swift):
        controller.restore(Memory())
        controller.tick(standing, command)
    for _ in range(12):
        slow.tick(standing, command)
    swift.skip(12, standing, command)
    assert swift.memory.tick == slow.memory.tick
    assert swift.stance == slow.stance != (True,) * 4
    np.testing.assert_allclose(swift.memory.reference, slow.memory.reference, atol=1e-12)


class _Unsolvable:
    def reset(self):
        pass

    def solve(self, body, task):
        return None
