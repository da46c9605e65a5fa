"""The channel ``obs`` equals what the true channels say, by formulas of the tests' own."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.mujoco.make_policies import linear
from tests.mujoco.robots import LEGS, OTHER, SPIN, opened, quadruped, robot, save, weights

BASE = f"decimation = 4\nduration = 0.4\n{SPIN}"
TICKS = np.array([0, 1, 2, 7, 13, 20])
DEFAULT = {"fl": 0.1, "fr": -0.2, "rl": 0.3, "rr": -0.4}
COMMAND = "command = { lin_vel_x = 0.5, lin_vel_y = -0.25, ang_vel_z = 0.125 }\n"


def attitude(trace, name="quaternion"):
    return Rotation.from_quat(np.array(trace[name]), scalar_first=True)


def world_velocity(trace):
    return attitude(trace).apply(np.array(trace["velocity"]))


def last_action(trace):
    return np.vstack([np.zeros(4), trace["action"][:-1]])


def default(legs):
    return np.array([DEFAULT[leg] for leg in legs])


def turn(trace):
    return np.arange(len(trace.times)) * 0.02 * 2 * np.pi


DOWN = np.array([0.0, 0.0, -1.0])
TERMS = [
    ('"base_lin_vel"', 3, lambda t: t["velocity"]),
    ('"base_ang_vel"', 3, lambda t: t["omega"]),
    ('"projected_gravity"', 3, lambda t: attitude(t).inv().apply(DOWN)),
    ('"joint_pos"', 4, lambda t: t["q"]),
    ('"joint_vel"', 4, lambda t: t["dq"]),
    ('"joint_vel_rel"', 4, lambda t: t["dq"]),
    ('"last_action"', 4, last_action),
    ('"velocity_commands"', 3, lambda t: np.tile([0.5, -0.25, 0.125], (len(t.times), 1))),
    ('{ sensor = "accelerometer" }', 3, lambda t: t["accelerometer"]),
    ('{ term = "base_lin_vel", frame = "world" }', 3, world_velocity),
    ('{ term = "base_ang_vel", frame = "world" }', 3, lambda t: attitude(t).apply(np.array(t["omega"]))),
    ('{ term = "base_lin_vel", frame = "imu" }', 3, lambda t: t["velocimeter"]),
    ('{ term = "base_ang_vel", frame = "imu" }', 3, lambda t: t["gyro"]),
    ('{ term = "projected_gravity", frame = "imu" }', 3, lambda t: attitude(t, "imu_attitude").inv().apply(DOWN)),
    ('{ term = "joint_vel", scale = 0.05 }', 4, lambda t: 0.05 * t["dq"]),
    ('{ term = "joint_vel", clip = 0.5 }', 4, lambda t: np.clip(t["dq"], -0.5, 0.5)),
    ('{ term = "joint_vel", clip = [-0.1, 0.5], scale = 3 }', 4, lambda t: 3 * np.clip(t["dq"], -0.1, 0.5)),
    ('{ term = "base_lin_vel", scale = [1, 2, 3] }', 3, lambda t: t["velocity"] * [1, 2, 3]),
    ('{ phase = 1.5, start = [0, 2], as = ["cos", "sin"] }', 4, lambda t: np.stack(
        [f(s + 1.5 * turn(t)) for f in (np.cos, np.sin) for s in (0, 2)], axis=1)),
    ('{ phase = 0.8, unit = "s" }', 2, lambda t: np.stack([np.sin(turn(t) / 0.8), np.cos(turn(t) / 0.8)], axis=1)),
    ('{ term = "terms.py:tilt" }', 2, lambda t: np.stack([t["z"], 2 * t["x"]], axis=1)),
    ('"terms.py:commanded"', 1, lambda t: np.full((len(t.times), 1), 0.5)),
]  # fmt: skip
"""Term, its width, and its value at every sample."""
OF_LEGS = [
    ('"joint_pos_rel"', LEGS, lambda q, dq, legs: q - default(legs)),
    ('{ term = "joint_pos_rel", joints = ["f."] }', ("fl", "fr"), lambda q, dq, legs: q - default(legs)),
    ('{ term = "joint_vel", joints = ["rr", "fl"] }', ("fl", "rr"), lambda q, dq, legs: dq),
    ('{ term = "joint_pos", joints = [".l"], scale = [1, 10] }', ("fl", "rl"), lambda q, dq, legs: q * [1, 10]),
]  # fmt: skip
"""Term of joints, the joints that it has in any order, and its value."""


@pytest.fixture
def own_terms(tmp_path, nothing_loaded):
    (tmp_path / "terms.py").write_text(
        "def tilt(model, data, command):\n    return data.qpos[2], 2 * data.qpos[0]\n\n\n"
        "def commanded(model, data, command):\n    return command[0]\n"
    )
    return tmp_path


def test_every_term_is_what_the_true_channels_say(own_terms):
    width = sum(width for _, width, _ in TERMS)
    text = ", ".join(term for term, _, _ in TERMS)
    trace = robot(own_terms, f"{BASE}{COMMAND}observation = [{text}]\n", width).rollout({}, 3)
    first = 0
    for term, width, value in TERMS:
        np.testing.assert_allclose(
            trace["obs"][TICKS, first : first + width],
            value(trace)[TICKS],
            rtol=2e-6,
            atol=2e-6,
            err_msg=term,
        )
        first += width
    assert np.abs(trace["action"]).max() > 0.1
    assert {"vx_cmd", "vy_cmd", "wz_cmd", "phase"} <= {*trace.channels}
    moved = np.gradient(np.stack([trace[name] for name in "xyz"], axis=1), trace.times, axis=0)[5:-5]
    np.testing.assert_allclose(world_velocity(trace)[5:-5], moved, atol=0.05)


@pytest.mark.parametrize("legs", [LEGS, OTHER])
def test_terms_of_joints_in_two_orders_of_the_model(tmp_path, legs):
    """Default positions by name; a pattern reads the joints in the model's order."""
    text = ", ".join(term for term, _, _ in OF_LEGS)
    width = sum(len(names) for _, names, _ in OF_LEGS)
    table = ", ".join(f"{leg} = {value}" for leg, value in DEFAULT.items())
    toml = f"{BASE}observation = [{text}]\ndefault_joint_pos = {{ {table} }}\n"
    trace = robot(tmp_path, toml, width, quadruped(legs)).rollout({}, 3)
    first = 0
    for term, names, value in OF_LEGS:
        chosen = [i for i, leg in enumerate(legs) if leg in names]
        own = [legs[i] for i in chosen]
        found = trace["obs"][TICKS, first : first + len(own)]
        wanted = value(trace["q"][:, chosen], trace["dq"][:, chosen], own)[TICKS]
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6, err_msg=term)
        first += len(own)


def test_the_action_has_the_order_of_action_joints(tmp_path):
    """Rows of policy joints move those joints, and joint terms have the policy's order."""
    toml = f'{BASE}observation = ["joint_pos"]\naction.joints = ["rr", "fl", "rl", "fr"]\n'
    trace = robot(tmp_path, toml, 4).rollout({}, 3)
    order = [LEGS.index(leg) for leg in OTHER]
    np.testing.assert_allclose(trace["obs"], trace["q"][:, order], atol=1e-7)
    np.testing.assert_allclose(trace["target"][:, order], trace["action"], atol=1e-12)


def stacked(values, history, start="first"):
    """Return (n, history, width): at every sample the last values, oldest first."""
    before = np.repeat(values[:1] if start == "first" else np.zeros_like(values[:1]), history - 1, axis=0)
    whole = np.vstack([before, values])
    return np.stack([whole[i : i + history] for i in range(len(values))])


def test_histories_by_term_hold_each_terms_values_oldest_first(tmp_path):
    terms = (
        '{ term = "joint_pos", history = 3 }, "base_ang_vel", { sensor = "height", scale = 2, history = 5 }'
    )
    trace = robot(tmp_path, f"{BASE}observation = [{terms}]\n", 12 + 3 + 5).rollout({}, 3)
    wanted = [stacked(trace["q"], 3), trace["omega"], stacked(2 * trace["sensor_height"][:, None], 5)]
    flat = np.hstack([one.reshape(len(trace.times), -1) for one in wanted])
    np.testing.assert_allclose(trace["obs"], flat, rtol=1e-6, atol=1e-6)


def test_a_history_by_time_holds_whole_observations(tmp_path):
    terms = '{ term = "joint_pos", history = 3 }, { term = "base_ang_vel", history = 3, clip = 0.5 }'
    toml = f'{BASE}observation = [{terms}]\nhistory_by = "time"\nobservation_clip = 0.4\n'
    trace = robot(tmp_path, toml, 21).rollout({}, 3)
    values = np.clip(np.hstack([trace["q"], trace["omega"]]), -0.4, 0.4)
    np.testing.assert_allclose(
        trace["obs"], stacked(values, 3).reshape(len(values), -1), rtol=1e-6, atol=1e-6
    )


RL_SAR = """\
box:
  dt: 0.005
  num_of_dofs: 4
  decimation: 4
  fixed_kp: [1, 1, 1, 1]
  fixed_kd: [1, 1, 1, 1]
  torque_limits: [2, 3, 4, 5]
  default_dof_pos: [0, 0, 0, 0]
  joint_names: ["fl", "fr", "rl", "rr"]
  joint_mapping: [3, 0, 2, 1]
"""
RL_SAR_CONFIG = """\
box/walk:
  model_name: "policy.onnx"
  num_of_dofs: 4
  default_dof_pos: [0.1, -0.2, 0.3, -0.4]
  num_observations: 14
  observations: ["ang_vel", "dof_pos", "dof_vel", "commands"]
  observations_history: [{ages}]
  observations_history_priority: "{by}"
  clip_obs: 0.6
  clip_actions_lower: [-0.1, -0.1, -0.1, -0.1]
  clip_actions_upper: [0.2, 0.2, 0.2, 0.2]
  rl_kp: [10, 20, 30, 40]
  rl_kd: [0.1, 0.2, 0.3, 0.4]
  action_scale: [0.5, 0.5, 0.5, 0.5]
  wheel_indices: []
  ang_vel_scale: 0.25
  dof_pos_scale: 1.0
  dof_vel_scale: 0.05
  commands_scale: [2.0, 2.0, 0.25]
"""


@pytest.mark.parametrize(("ages", "by"), [("0, 1, 2", "time"), ("2, 1, 0", "time"), ("0, 1, 2", "term")])
def test_histories_of_rl_sar_begin_with_zeros_and_may_be_newest_first(tmp_path, ages, by):
    """Its default pose is in the order of the policy, and its names are in that of the motors."""
    folder = tmp_path / "box" / "walk"
    folder.mkdir(parents=True)
    (tmp_path / "box" / "base.yaml").write_text(RL_SAR)
    (folder / "config.yaml").write_text(RL_SAR_CONFIG.format(ages=ages, by=by))
    (tmp_path / "box.xml").write_text(quadruped(OTHER))
    save(tmp_path, "policy.onnx", linear(weights(4, 42)))
    head = 'model = "box.xml"\npolicy = "policy.onnx"\ndeploy = "box/walk/config.yaml"\n'
    trace = opened(tmp_path, f"{head}duration = 0.4\n{COMMAND}{SPIN}").rollout({}, 3)
    names = ["rr", "fl", "rl", "fr"]  # motors 3, 0, 2, 1
    order = [OTHER.index(name) for name in names]
    pose, command = np.array([0.1, -0.2, 0.3, -0.4]), np.array([0.5, -0.25, 0.125])
    parts = [
        0.25 * trace["omega"], trace["q"][:, order] - pose, 0.05 * trace["dq"][:, order],
        np.tile(command * [2, 2, 0.25], (len(trace.times), 1)),
    ]  # fmt: skip
    step = -1 if ages.startswith("0") else 1
    clipped = [stacked(np.clip(part, -0.6, 0.6), 3, "zero")[:, ::step] for part in parts]
    if by == "time":
        flat = np.concatenate(clipped, axis=2).reshape(len(trace.times), -1)
    else:
        flat = np.hstack([part.reshape(len(trace.times), -1) for part in clipped])
    np.testing.assert_allclose(trace["obs"], flat, rtol=1e-6, atol=1e-6)
    target = pose + 0.5 * np.clip(trace["action"], -0.1, 0.2)
    np.testing.assert_allclose(trace["target"][:, order], target, atol=1e-7)
    assert trace.times[1] == pytest.approx(0.02)
    kp, kd = np.array([10, 20, 30, 40]), np.array([0.1, 0.2, 0.3, 0.4])
    torque = kp * (target - trace["q"][:, order]) - kd * trace["dq"][:, order]
    np.testing.assert_allclose(
        trace["tau"][:, order], np.clip(torque, [-2, -3, -4, -5], [2, 3, 4, 5]), atol=1e-5
    )


def test_a_term_of_the_robot_file_may_have_its_newest_value_first(tmp_path):
    terms = '{ term = "joint_pos", history = 3, newest_first = true }, { term = "base_ang_vel", history = 2 }'
    trace = robot(tmp_path, f"{BASE}observation = [{terms}]\n", 18).rollout({}, 3)
    wanted = [stacked(trace["q"], 3)[:, ::-1], stacked(trace["omega"], 2)]
    flat = np.hstack([one.reshape(len(trace.times), -1) for one in wanted])
    np.testing.assert_allclose(trace["obs"], flat, rtol=1e-6, atol=1e-6)
