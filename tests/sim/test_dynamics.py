"""The plant's model and the controller's model are the same robot."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from s2r_sim.controller.dynamics import RigidBody
from s2r_sim.plant import mujoco_model
from s2r_sim.plant.physics import Physics
from s2r_sim.robot import pinocchio_model, rotation
from s2r_sim.robot.constants import A1, LEGS
from s2r_sim.robot.signals import RobotState
from tests.sim.rotations import matrix


@pytest.fixture(scope="module")
def models():
    plant = mujoco_model.build(A1, Physics(armature=0.0, dry_friction=0.0, damping=0.0))
    return plant, mujoco.MjData(plant), pinocchio_model.build(A1)


def random_state(seed):
    rng = np.random.default_rng(seed)
    low, high = np.transpose([limit for _ in LEGS for limit in A1.limits])
    return rng.normal(size=3), rng.uniform(-1, 1, 3), rng.uniform(low, high), rng.normal(size=18)


def both(models, seed):
    """Return MuJoCo's data and Pinocchio's (q, v) at one state, and S: v_pin = S v_mujoco."""
    plant, data, _ = models
    position, rpy, joints, v = random_state(seed)
    x, y, z, w = rotation.quaternion(*rpy)
    data.qpos[:] = [*position, w, x, y, z, *joints]
    data.qvel[:] = v
    mujoco.mj_forward(plant, data)
    S = np.eye(18)
    S[:3, :3] = matrix(*rpy).T
    return data, np.array([*position, x, y, z, w, *joints]), S


@pytest.mark.parametrize("seed", range(5))
def test_mass_matrices_agree(models, seed):
    plant, _, model = models
    data, q, S = both(models, seed)
    theirs = np.zeros((18, 18))
    mujoco.mj_fullM(plant, data, theirs)
    pin_data = model.createData()
    ours = np.triu(pin.crba(model, pin_data, q))
    ours += np.triu(ours, 1).T
    np.testing.assert_allclose(S.T @ ours @ S, theirs, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_gravity_and_velocity_forces_agree(models, seed):
    _, _, model = models
    data, q, S = both(models, seed)
    v = S @ data.qvel
    # Spatial and classical acceleration of the base differ by ω × v, which MuJoCo counts as a force.
    a = np.zeros(18)
    a[:3] = -np.cross(v[3:6], v[:3])
    ours = pin.rnea(model, model.createData(), q, v, a)
    np.testing.assert_allclose(S.T @ ours, data.qfrc_bias, atol=1e-9)


def test_feet_are_at_the_same_place(models):
    _, _, model = models
    data, q, _ = both(models, 0)
    pin_data = model.createData()
    pin.framesForwardKinematics(model, pin_data, q)
    for leg in LEGS:
        frame = model.getFrameId(f"{leg.name}_foot")
        np.testing.assert_allclose(
            pin_data.oMf[frame].translation, data.geom(f"{leg.name}_foot").xpos, atol=1e-12
        )


def test_rotations_agree_with_each_other():
    for rpy in ((0.3, -0.4, 2.0), (-0.1, 1.2, -3.0), (0.0, 0.0, 0.0)):
        x, y, z, w = rotation.quaternion(*rpy)
        np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), matrix(*rpy), atol=1e-15)
        np.testing.assert_allclose(rotation.rpy_from_wxyz(w, x, y, z), rpy, atol=1e-14)


def random_body(seed):
    """Return the controller's picture of a robot in any state, and Pinocchio's model and data of the same."""
    position, rpy, joints, v = random_state(seed)
    body = RigidBody(A1, rotor_inertia=0.005)
    body.update(RobotState(np.concatenate([position, rpy, v[:6], joints, v[6:]])))
    x, y, z, w = rotation.quaternion(*rpy)
    model = pinocchio_model.build(A1, 0.005)
    data = model.createData()
    q = np.array([*position, x, y, z, w, *joints])
    twist = np.concatenate([matrix(*rpy).T @ v[:3], v[3:]])
    pin.computeAllTerms(model, data, q, twist)
    pin.forwardKinematics(model, data, q, twist, np.zeros(18))
    pin.updateFramePlacements(model, data)
    return body, model, data, twist


@pytest.mark.parametrize("seed", range(5))
def test_feet_move_as_pinocchio_says(seed):
    body, model, data, twist = random_body(seed)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for i, leg in enumerate(LEGS):
        rows, frame = slice(3 * i, 3 * i + 3), model.getFrameId(f"{leg.name}_foot")
        jacobian = pin.getFrameJacobian(model, data, frame, axes)[:3]
        drift = pin.getFrameClassicalAcceleration(model, data, frame, axes).linear
        np.testing.assert_allclose(body.feet[i], data.oMf[frame].translation, atol=1e-14)
        np.testing.assert_allclose(body.thighs[i], data.oMi[3 * i + 3].translation, atol=1e-14)
        np.testing.assert_allclose(body.jacobian[rows], jacobian, atol=1e-13)
        np.testing.assert_allclose(body.speeds[i], jacobian @ twist, atol=1e-12)
        np.testing.assert_allclose(body.drift[rows], drift, atol=1e-11)
        np.testing.assert_allclose(body.known[2, rows], jacobian[:, :6] @ twist[:6], atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_laws_of_motion_are_pinocchios(seed):
    body, _, data, twist = random_body(seed)
    np.testing.assert_allclose(body.twist, twist, atol=1e-14)
    np.testing.assert_allclose(np.triu(body.mass_upper), np.triu(data.M), atol=1e-12)
    np.testing.assert_allclose(body.bias, data.nle, atol=1e-11)


def test_a_state_of_mujoco_keeps_its_parts():
    rng = np.random.default_rng(0)
    x, y, z, w = rotation.quaternion(0.3, -0.4, 2.0)
    qpos, qvel = rng.normal(size=19), rng.normal(size=18)
    qpos[3:7] = w, x, y, z
    state = RobotState(rotation.from_mujoco(qpos, qvel))
    np.testing.assert_allclose(state.rpy, [0.3, -0.4, 2.0], atol=1e-14)
    assert np.concatenate([state.position, state.q]).tolist() == [*qpos[:3], *qpos[7:]]
    assert np.concatenate([state.velocity, state.omega, state.dq]).tolist() == qvel.tolist()
