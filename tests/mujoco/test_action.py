"""From actions to torques: each law against a loop that the test writes out, or against a model that says the same."""

import mujoco
import numpy as np
import onnxruntime
import pytest

from s2r_spec.errors import UsageError
from tests.errors import naming
from tests.mujoco.make_policies import linear
from tests.mujoco.robots import LEGS, OTHER, SPIN, opened, quadruped, robot, save, weights

BASE = (
    'decimation = 4\nduration = 0.4\nobservation = ["joint_pos_rel", { term = "joint_vel", scale = 0.05 }]\n'
    + SPIN
)
PD = "action = { scale = 0.5, stiffness = 30, damping = 0.8 }\n"
POSITION = '<position name="{{leg}}" joint="{{leg}}" kp="{}" kv="{}"/>'


def state(trace):
    """Return qpos and qvel at t = 0 from the true channels."""
    position = [trace["x"][0], trace["y"][0], trace["z"][0], *trace["quaternion"][0], *trace["q"][0]]
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.array(trace["velocity"][0]), np.array(trace["quaternion"][0]))
    return np.array(position), np.array([*turned, *trace["omega"][0], *trace["dq"][0]])


@pytest.mark.parametrize("legs", [LEGS, OTHER])
def test_explicit_gains_equal_a_loop_written_out_bit_for_bit(tmp_path, legs):
    """Torques at every physics step, inference at every fourth; the robot stands still at the start."""
    toml = BASE.replace(SPIN, "") + PD + "default_joint_pos = { 'f.' = 0.2, 'r.' = -0.1 }\n"
    trace = robot(tmp_path, toml, 8, quadruped(legs)).rollout({}, 5)
    session = onnxruntime.InferenceSession(str(tmp_path / "policy.onnx"))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "box.xml"))
    data = mujoco.MjData(model)
    pose = np.array([0.2 if leg[0] == "f" else -0.1 for leg in legs])
    data.qpos[:], data.qvel[:] = state(trace)
    mujoco.mj_forward(model, data)
    for tick in range(len(trace.times)):
        assert np.array_equal(data.qpos[7:], trace["q"][tick])
        assert np.array_equal(data.qvel[6:], trace["dq"][tick])
        assert data.qpos[2] == trace["z"][tick]
        assert np.array_equal(data.sensordata[:3], trace["gyro"][tick])
        observed = np.concatenate([data.qpos[7:] - pose, 0.05 * data.qvel[6:]]).astype(np.float32)
        action = session.run(None, {"obs": observed[None]})[0][0].astype(np.float64)
        for _ in range(4):
            data.ctrl[:] = 30 * (pose + 0.5 * action - data.qpos[7:]) - 0.8 * data.qvel[6:]
            mujoco.mj_step(model, data)


def trace_of(folder, model, toml, name):
    (folder / name).mkdir()
    return robot(folder / name, toml, 8, model).rollout({}, 5)


@pytest.mark.parametrize(
    ("actuator", "action"),
    [
        ("", 'action = { pd = "implicit", stiffness = 30, damping = 0.8 }'),
        (POSITION.format(5, 0.1), "action = { stiffness = 30, damping = 0.8 }"),
        ('<motor name="{leg}" joint="{leg}" gear="4"/>', 'action = { pd = "implicit", stiffness = 30, damping = 0.8 }'),
    ],
    ids=["motors", "position actuators of other gains", "geared motors"],
)  # fmt: skip
def test_gains_inside_of_mujoco_equal_position_actuators_of_the_model(tmp_path, actuator, action):
    options = 'timestep="0.005" integrator="implicitfast"'
    one = trace_of(tmp_path, quadruped(actuator=actuator, options=options), f"{BASE}{action}\n", "one")
    model = quadruped(actuator=POSITION.format(30, 0.8), options=options)
    other = trace_of(tmp_path, model, BASE, "other")
    for name in ("q", "z", "target", "tau"):
        np.testing.assert_allclose(one[name], other[name], rtol=1e-7, atol=1e-7, err_msg=name)
    assert np.abs(one["tau"]).max() > 1


@pytest.mark.parametrize("gear", [1, 4, -2])
@pytest.mark.parametrize("pd", ["explicit", "implicit"])
def test_a_gear_changes_no_torque_of_gains(tmp_path, gear, pd):
    """Nor does a gain of the actuator."""
    motor = f'<general name="{{leg}}" joint="{{leg}}" gear="{gear}" gainprm="3"/>'
    toml = f'{BASE}action = {{ pd = "{pd}", stiffness = 30, damping = 0.8 }}\n'
    trace = robot(tmp_path, toml, 8, quadruped(actuator=motor)).rollout({}, 5)
    torque = 30 * (trace["target"] - trace["q"]) - 0.8 * trace["dq"]
    np.testing.assert_allclose(trace["tau"], torque, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("pd", ["explicit", "implicit"])
def test_limits_of_a_motor_limit_the_torque(tmp_path, pd):
    motor = '<motor name="{leg}" joint="{leg}" gear="2" ctrlrange="-0.5 0.5" ctrllimited="true"/>'
    toml = f'{BASE}action = {{ pd = "{pd}", stiffness = 30, damping = 0.8 }}\n'
    trace = robot(tmp_path, toml, 8, quadruped(actuator=motor)).rollout({}, 5)
    torque = 30 * (trace["target"] - trace["q"]) - 0.8 * trace["dq"]
    np.testing.assert_allclose(trace["tau"], np.clip(torque, -1, 1), rtol=1e-6, atol=1e-6)
    assert np.abs(torque).max() > 1.5


def test_a_clip_limits_the_target_and_not_the_last_action(tmp_path):
    toml = BASE.replace('{ term = "joint_vel", scale = 0.05 }', '"last_action"') + PD.replace(
        "{ scale", "{ clip = [-0.01, 0.02], scale"
    )
    trace = robot(tmp_path, toml, 8).rollout({}, 5)
    free = 0.5 * trace["action"]
    np.testing.assert_allclose(trace["target"], np.clip(free, -0.01, 0.02), atol=1e-12)
    assert free.max() > 0.02
    np.testing.assert_allclose(trace["obs"][1:, 4:], trace["action"][:-1], atol=1e-7)


def test_tables_by_names_of_joints_and_an_offset(tmp_path):
    toml = (
        BASE + 'action = { scale = { "f." = 0.5, "r." = 2 }, offset = [0.1, 0.2, 0.3, 0.4], '
        'stiffness = { fl = 10, fr = 20, "r[lr]" = 30 }, damping = 0.5 }\n'
    )
    trace = robot(tmp_path, toml, 8).rollout({}, 5)
    target = trace["action"] * [0.5, 0.5, 2, 2] + [0.1, 0.2, 0.3, 0.4]
    np.testing.assert_allclose(trace["target"], target, atol=1e-12)
    np.testing.assert_allclose(
        trace["tau"], [10, 20, 30, 30] * (target - trace["q"]) - 0.5 * trace["dq"], atol=1e-9
    )


def test_without_gains_an_action_is_the_torque(tmp_path):
    trace = robot(tmp_path, BASE + "action.scale = 0.5\n", 8).rollout({}, 5)
    np.testing.assert_allclose(trace["tau"], 0.5 * trace["action"], atol=1e-12)


def test_a_policy_of_some_joints_leaves_the_others_alone(tmp_path):
    toml = BASE + PD.replace("{ scale", '{ joints = ["rr", "fl"], scale')
    trace = robot(tmp_path, toml, 4, outputs=2).rollout({}, 5)
    np.testing.assert_allclose(trace["obs"][:, :2], trace["q"][:, [3, 0]], atol=1e-7)
    assert (trace["tau"][:, [1, 2]] == 0).all()
    torque = 30 * (0.5 * trace["action"] - trace["q"][:, [3, 0]]) - 0.8 * trace["dq"][:, [3, 0]]
    np.testing.assert_allclose(trace["tau"][:, [3, 0]], torque, atol=1e-9)


def test_actuators_that_the_policy_does_not_move_keep_the_keyframes_controls(tmp_path):
    """Those of an actuator with a state, too."""
    slow = '<general name="{leg}" joint="{leg}" dyntype="filter" dynprm="0.5" gainprm="30" biastype="affine" '
    slow += 'biasprm="0 -30 -1"/>'
    key = '<key name="home" qpos="0 0 2 1 0 0 0 0 0 0 0" ctrl="0.3 0.4 0.5 0.6" act="0.1 0.2 0.3 0.4"/>'
    model = quadruped(actuator=slow, extra=f"<keyframe>{key}</keyframe>")
    toml = BASE.replace(SPIN, "") + 'keyframe = "home"\naction.joints = ["fl", "fr"]\n'
    trace = robot(tmp_path, toml, 4, model, outputs=2).rollout({}, 5)
    now = np.exp(-trace.times[:, None] / 0.5)
    state = np.array([0.5, 0.6]) * (1 - now) + np.array([0.3, 0.4]) * now
    torque = 30 * (state - trace["q"][:, 2:]) - trace["dq"][:, 2:]
    np.testing.assert_allclose(trace["tau"][:, 2:], torque, atol=0.05)
    assert np.abs(torque).max() > 1


def test_unstable_gains_go_into_mujoco_with_a_note_unless_the_file_chooses(tmp_path):
    toml = BASE + "action = { scale = 0.5, stiffness = 30, damping = { fr = 9, '[^f].|fl' = 0.8 } }\n"
    gains = {}
    for name, text in (("own", toml), ("chosen", toml.replace("{ scale", '{ pd = "explicit", scale'))):
        (tmp_path / name).mkdir()
        backend = robot(tmp_path / name, text, 8)
        gains[name] = next(one for one in backend.preflight(run=False) if one.topic == "gains")
        assert "fr" in gains[name].words
    assert gains["own"].level == "note"
    assert gains["chosen"].level == "wrong"
    own, chosen = (opened(tmp_path / name, (tmp_path / name / "robot.toml").read_text()) for name in gains)
    assert "failure" not in own.rollout({}, 5).meta
    assert chosen.rollout({}, 5).meta["failure"] == "unstable"


DEPLOY = """\
joint_ids_map: [2, 0, 3, 1]
step_dt: 0.02
stiffness: [10, 20, 30, 40]
damping: [0.1, 0.2, 0.3, 0.4]
default_joint_pos: [0.1, -0.2, 0.3, -0.4]
commands: {base_velocity: {ranges: {lin_vel_x: [-0.5, 1.0], lin_vel_y: [0, 0], ang_vel_z: [0, 0]}}}
actions:
  JointPositionAction:
    clip: [[-0.3, 0.3], [-0.3, 0.3], [-0.3, 0.22], [-0.45, 0.3]]
    joint_names: [.*]
    scale: [0.1, 0.2, 0.3, 0.4]
    offset: [0.1, -0.2, 0.3, -0.4]
    joint_ids: !!python/object/apply:builtins.slice [null, null, null]
observations:
  velocity_commands: {params: {command_name: base_velocity}, scale: [1, 1, 1], history_length: 1}
  joint_pos_rel: {params: {}, clip: null, scale: [1.0, 1.0, 1.0, 1.0], history_length: 2}
"""
HEAD = 'model = "box.xml"\npolicy = "policy.onnx"\ndeploy = "deploy.yaml"\nduration = 0.4\n'


def deployed(folder, deploy=DEPLOY, toml="", model=None):
    (folder / "deploy.yaml").write_text(deploy)
    (folder / "box.xml").write_text(model or quadruped())
    save(folder, "policy.onnx", linear(weights(4, 11, 0.5)))
    return opened(folder, HEAD + (toml or SPIN))


def test_a_deploy_file_drives_the_right_joint_with_the_right_gain_and_default(tmp_path):
    """Gains are in the order of the motors; the rest is in that of the policy, whose joint i is motor map[i]."""
    trace = deployed(tmp_path, toml=f'command.lin_vel_x = "vd"\n{SPIN}').rollout({"vd": 1.0}, 5)
    motor = [2, 0, 3, 1]
    pose, q, dq = np.array([0.1, -0.2, 0.3, -0.4]), trace["q"][:, motor], trace["dq"][:, motor]
    free = pose + [0.1, 0.2, 0.3, 0.4] * trace["action"]
    target = np.clip(free, [-0.3, -0.3, -0.3, -0.45], [0.3, 0.3, 0.22, 0.3])
    assert (target != free).any()
    np.testing.assert_allclose(trace["target"][:, motor], target, atol=1e-9)
    kp, kd = np.array([10, 20, 30, 40])[motor], np.array([0.1, 0.2, 0.3, 0.4])[motor]
    np.testing.assert_allclose(trace["tau"][:, motor], kp * (target - q) - kd * dq, atol=1e-6)
    np.testing.assert_allclose(trace["obs"][:, 7:], q - pose, atol=1e-6)
    assert trace["vx_cmd"][0] == trace["obs"][0, 0] == 1.0
    assert [(one.name, one.low, one.high) for one in deployed(
        tmp_path, toml='command.lin_vel_x = "vd"\n').parameters] == [("vd", -0.5, 1.0)]  # fmt: skip


def test_an_action_of_a_deploy_file_moves_some_of_its_joints(tmp_path):
    """The others stay at their default positions; ``action`` has a column for each component."""
    deploy = DEPLOY.replace("[[-0.3, 0.3], [-0.3, 0.3], [-0.3, 0.22], [-0.45, 0.3]]", "null")
    deploy = deploy.replace("[0.1, 0.2, 0.3, 0.4]\n    offset: [0.1, -0.2, 0.3, -0.4]", "[0.3, 0.4]")
    deploy = deploy.replace("!!python/object/apply:builtins.slice [null, null, null]", "[3, 0]")
    (tmp_path / "deploy.yaml").write_text(deploy)
    (tmp_path / "box.xml").write_text(quadruped())
    save(tmp_path, "policy.onnx", linear(weights(2, 11, 0.5)))
    backend = opened(tmp_path, HEAD + SPIN)
    trace = backend.rollout({}, 5)
    assert {one.name: one.columns for one in backend.channels}["action"] == ("fr", "rl")
    assert trace["action"].shape == (21, 2)
    pose = {"rl": 0.1, "fl": -0.2, "rr": 0.3, "fr": -0.4}
    target = np.tile([pose[leg] for leg in LEGS], (21, 1))
    target[:, 1] += 0.3 * trace["action"][:, 0]
    target[:, 2] += 0.4 * trace["action"][:, 1]
    np.testing.assert_allclose(trace["target"], target, atol=1e-9)


def test_the_robot_starts_in_the_deploy_files_pose(tmp_path):
    trace = deployed(tmp_path, toml='command.lin_vel_x = "vd"\n').rollout({"vd": 0.0}, 5)
    assert trace["q"][0] == pytest.approx([-0.2, -0.4, 0.1, 0.3])


@pytest.mark.parametrize(
    ("deploy", "model", "facts"),
    [
        (DEPLOY, quadruped(LEGS[:3]), ["deploy.yaml", "4 joints", "3 actuators", "action.joints"]),
        (DEPLOY.replace("[0.1, -0.2, 0.3, -0.4]\ncommands", "[0.1, -0.2, 1.8, -0.4]\ncommands"), None,
         ["deploy.yaml", "1.8", "rr", "[-1.2, 1.5]", "order"]),
        (DEPLOY, quadruped((*LEGS[:3], "rr", )).replace('<motor name="rr" joint="rr"/>', ""),
         ["deploy.yaml", "4 joints", "3 actuators"]),
    ],
)  # fmt: skip
def test_a_deploy_file_of_another_robot_is_refused(tmp_path, deploy, model, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        deployed(tmp_path, deploy, model=model)


WHEELS = """\
box/roll:
  num_of_dofs: 4
  default_dof_pos: [0.1, -0.2, 0.3, 0.0]
  observations: ["dof_pos", "dof_vel"]
  clip_actions_lower: []
  clip_actions_upper: []
  rl_kp: [10, 20, 30, 0.5]
  rl_kd: [0.1, 0.2, 0.3, 0.4]
  action_scale: [0.5, 0.5, 0.5, 5.0]
  clip_obs: 100.0
  wheel_indices: [3]
  dof_pos_scale: 1.0
  dof_vel_scale: 0.05
  dt: 0.005
  decimation: 4
  joint_names: ["fl", "fr", "rl", "rr"]
  joint_mapping: [0, 1, 2, 3]
"""


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize("pd", ["explicit", "implicit"])
@pytest.mark.parametrize("kind", ["motor", "position"])
def test_a_wheel_follows_a_velocity_and_is_held_at_its_default_position(tmp_path, kind, pd, gear):
    """Whatever the actuators are, and wherever the gains act."""
    (tmp_path / "box").mkdir()
    (tmp_path / "box" / "config.yaml").write_text(WHEELS)
    actuator = f'<{kind} name="{{leg}}" joint="{{leg}}" gear="{gear}"/>'
    (tmp_path / "box.xml").write_text(quadruped(actuator=actuator))
    save(tmp_path, "policy.onnx", linear(weights(4, 8, 0.5)))
    head = 'model = "box.xml"\npolicy = "policy.onnx"\ndeploy = "box/config.yaml"\nduration = 0.4\n'
    trace = opened(tmp_path, f'{head}action.pd = "{pd}"\n{SPIN}').rollout({}, 3)
    kp, kd, pose = np.array([10, 20, 30, 0.5]), np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.1, -0.2, 0.3, 0])
    target = pose + [0.5, 0.5, 0.5, 5] * trace["action"]
    np.testing.assert_allclose(trace["target"], target, atol=1e-7)
    speed = np.array([False, False, False, True])
    torque = kp * (np.where(speed, pose, target) - trace["q"]) + kd * (
        np.where(speed, target, 0) - trace["dq"]
    )
    np.testing.assert_allclose(trace["tau"], torque, rtol=1e-6, atol=1e-6)
