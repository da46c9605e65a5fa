"""The robot's own velocity estimate, and the leg kinematics under it."""

from math import cos, sin

import numpy as np
import pinocchio as pin
import pytest

from s2r_sim import SimBackend
from s2r_sim.controller import estimator
from s2r_sim.robot import pinocchio_model, rotation
from s2r_sim.robot.constants import A1, LEGS
from s2r_sim.robot.leg_kinematics import foot_motion
from s2r_sim.robot.signals import RobotState
from tests.sim.rotations import matrix

MODEL = pinocchio_model.build(A1)


def random_state(seed):
    rng = np.random.default_rng(seed)
    return RobotState(
        np.concatenate([rng.uniform(-0.5, 0.5, 12), np.tile([0.1, 0.9, -1.7], 4), rng.normal(size=12)])
    )


def in_pinocchio(state):
    x, y, z, w = rotation.quaternion(*state.rpy)
    q = np.concatenate([state.position, [x, y, z, w], state.q])
    v = np.concatenate([state.velocity @ matrix(*state.rpy), state.omega, state.dq])
    data = MODEL.createData()
    pin.forwardKinematics(MODEL, data, q, v)
    pin.updateFramePlacements(MODEL, data)
    return data


@pytest.mark.parametrize("leg", LEGS, ids=lambda leg: leg.name)
def test_leg_kinematics_are_pinocchio_s(leg):
    state = random_state(leg.sx + 2 * leg.sy + 5)
    data = in_pinocchio(state)
    frame = MODEL.getFrameId(f"{leg.name}_foot")
    k = 3 * LEGS.index(leg)
    motion = foot_motion(A1, leg, state.q[k : k + 3], state.dq[k : k + 3], sin, cos)
    R = matrix(*state.rpy)
    spatial = pin.getFrameVelocity(MODEL, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    moved = np.cross(state.omega, motion.position) + motion.velocity
    np.testing.assert_allclose(state.position + R @ motion.position, data.oMf[frame].translation, atol=1e-12)
    np.testing.assert_allclose(state.velocity + R @ moved, spatial.linear, atol=1e-12)
    np.testing.assert_allclose(R @ (motion.spin + state.omega), spatial.angular, atol=1e-12)


def test_a_vector_is_turned_by_the_rotation_matrix_and_back():
    turned = rotation.rotate(0.3, -0.4, 2.0, (1.0, 2.0, 3.0), sin, cos)
    np.testing.assert_allclose(turned, matrix(0.3, -0.4, 2.0) @ [1.0, 2.0, 3.0], atol=1e-15)
    np.testing.assert_allclose(
        rotation.turned_back(0.3, -0.4, 2.0, turned, sin, cos), [1.0, 2.0, 3.0], atol=1e-14
    )


def test_tick_by_tick_and_all_at_once_give_the_same_estimate():
    rng = np.random.default_rng(0)
    states = np.array([random_state(k).flat for k in range(6)])
    stance = [(True, False, False, True), (True, True, True, True), (False, True, True, False)] * 2
    force = rng.normal(size=(6, 3)) + np.array([0.0, 0.0, 9.81])
    one, velocities = None, []
    for k in range(6):
        one = estimator.update(A1, one, RobotState(states[k]), tuple(force[k]), stance[k])
        velocities.append(one.velocity)
    together = estimator.replay(A1, RobotState(states.T), force.T, np.array(stance, dtype=float).T)
    np.testing.assert_allclose(together, velocities, atol=1e-13)


def test_odometry_is_exact_for_a_foot_that_rolls():
    state = random_state(1)
    data = in_pinocchio(state)
    frame = MODEL.getFrameId("FL_foot")
    spatial = pin.getFrameVelocity(MODEL, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    # Give the base the velocity with which this foot's lowest point stands still.
    state.velocity[:] -= spatial.linear + np.cross(spatial.angular, [0.0, 0.0, -A1.foot_radius])
    height, velocity = estimator.leg_odometry(A1, state, (False, True, False, False), sin, cos)
    np.testing.assert_allclose(velocity, state.velocity, atol=1e-12)
    assert height == pytest.approx(state.position[2] - data.oMf[frame].translation[2] + A1.foot_radius)


def test_inertial_measurement_carries_the_estimate_between_contacts():
    still = RobotState(np.concatenate([np.zeros(12), np.tile([0.0, 0.9, -1.8], 4), np.zeros(12)]))
    before = estimator.Estimate((0.0, 0.0, 0.28), (0.0, 0.0, 0.0))
    after = estimator.update(A1, before, still, (5.0, 0.0, 9.81), (True, False, False, True))
    assert after.velocity[0] == pytest.approx(5.0 / 500 * (1 - 1 / (estimator.BLEND * 500)))


def test_a_missed_tick_is_carried_over_by_the_time_that_passed():
    still = RobotState(np.concatenate([np.zeros(12), np.tile([0.0, 0.9, -1.8], 4), np.zeros(12)]))
    before = estimator.Estimate((0.0, 0.0, 0.28), (0.1, 0.0, 0.0))
    stance, force = (True, False, False, True), (0.0, 0.0, 9.81)
    one = estimator.update(A1, before, still, force, stance)
    assert one == estimator.update(A1, before, still, force, stance, ticks=1.0)
    three = estimator.update(A1, before, still, force, stance, ticks=3.0)
    apart = before
    for _ in range(3):
        apart = estimator.update(A1, apart, still, force, stance)
    # Odometry says 0 here: one step of 6 ms draws the velocity there as three of 2 ms do, to first order.
    assert three.velocity[0] == pytest.approx(apart.velocity[0], abs=0.003)
    assert three.position[0] == pytest.approx(three.velocity[0] * 0.006)
    pushed = estimator.update(A1, before, still, (5.0, 0.0, 9.81), stance, ticks=3.0)
    assert pushed.velocity[0] - three.velocity[0] == pytest.approx(5.0 * 0.006 * 0.7)


def test_after_a_long_gap_leg_odometry_alone_counts():
    still = RobotState(np.concatenate([np.zeros(12), np.tile([0.0, 0.9, -1.8], 4), np.zeros(12)]))
    before = estimator.Estimate((0.0, 0.0, 0.28), (0.4, 0.0, 0.0))
    after = estimator.update(A1, before, still, (0.0, 0.0, 9.81), (True,) * 4, ticks=50.0)
    np.testing.assert_allclose(after.velocity, 0.0, atol=1e-12)


@pytest.mark.parametrize("vd", [-0.2, 0.3])
def test_the_estimate_is_true_where_nothing_slips(vd):
    trace = SimBackend().rollout({"vd": vd}, 0)
    error = trace["vx_est"] - trace["vx"]
    assert abs(error.mean()) < 0.002
    assert error.std() < 0.006
    assert trace["vx_est"][-200:].mean() / trace["vx"][-200:].mean() == pytest.approx(1.0, abs=0.015)


def test_it_trots_as_well_on_its_own_estimate():
    own, true = (SimBackend(text, duration=2.0).rollout({"vd": 0.3}, 1) for text in ("feedback=estimate", ""))
    assert own.failure is None
    assert own["vx"][-400:].mean() == pytest.approx(true["vx"][-400:].mean(), abs=0.005)


def test_on_slippery_ground_the_estimate_reads_slip_as_speed():
    trace = SimBackend("feedback=estimate").rollout({"vd": 0.3, "friction": 0.1}, 1)
    assert np.abs(trace["vx_est"] - trace["vx"]).max() > 0.03
