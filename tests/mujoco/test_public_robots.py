"""Public robots and their policies from ``shared/robots`` beside the checkout: each walks as its README says."""

from math import cos, pi, sin

import mujoco
import numpy as np
import pytest

from benchmarks.robots.public import BERKELEY, G1_LAB, G1_LSTM, GO1, NOISE, ROBOTS
from s2r_spec.backend import Parameter
from s2r_spec.errors import UsageError
from tests.errors import states
from tests.mujoco.robots import opened, same

pytestmark = pytest.mark.skipif(
    not (ROBOTS / "README.md").exists(), reason="the public robots are not beside the checkout"
)
G1, LAB = ROBOTS / "g1_unitree_rl_gym", ROBOTS / "g1_unitree_rl_lab"
LSTM = G1_LSTM.replace(f"{NOISE}\n", "")


def mean_vx(backend, vd, seeds=range(4)):
    traces = [backend.rollout({"vd": vd}, seed) for seed in seeds]
    assert all(trace.failure is None for trace in traces)
    return float(np.mean([trace["vx"][trace.times >= 2].mean() for trace in traces]))


@pytest.mark.parametrize(
    ("text", "vd", "stated"), [(GO1, 0.5, 0.512), (BERKELEY, 0.3, 0.252), (BERKELEY, 0.5, 0.456)]
)
def test_a_legged_robot_walks_as_fast_as_its_readme_says(tmp_path, text, vd, stated):
    assert len(text.splitlines()) <= 12
    backend = opened(tmp_path, text).for_spec(_needs(vd))
    assert mean_vx(backend, vd) == pytest.approx(stated, rel=0.03)
    assert not [one for one in backend.preflight(run=False) if one.level == "wrong"]


def _needs(vd):
    class Wanted:
        parameters = (Parameter("vd", "m/s", 0.0, vd, 0.0, ""),)

    return Wanted


def test_the_g1_of_a_deploy_file_walks(tmp_path):
    """Its wrists would be unstable by torques at every physics step."""
    backend = opened(tmp_path, G1_LAB)
    assert {one.name: (one.low, one.high) for one in backend.parameters} == {"vd": (-0.5, 1.0)}
    assert mean_vx(backend, 0.5, range(2)) == pytest.approx(0.5, abs=0.06)
    assert abs(mean_vx(backend, 0.0, range(1))) < 0.05
    notes = [one for one in backend.preflight(run=False) if one.topic == "gains"]
    assert [one.level for one in notes] == ["note"]
    assert states(notes[0].words, "12 joints", "62.9", "left_wrist_roll_joint")


def test_the_g1_with_a_hidden_state_equals_its_deploy_loop_bit_for_bit(tmp_path):
    """As ``deploy_mujoco.py`` of unitree_rl_gym, with an inference at t = 0 and the state of the file."""
    import torch

    trace = opened(tmp_path, LSTM).rollout({"vd": 0.5}, 0)
    model = mujoco.MjModel.from_xml_path(str(G1 / "scene.xml"))
    data = mujoco.MjData(model)
    model.opt.timestep = 0.002
    mujoco.mj_resetData(model, data)
    with pytest.warns(DeprecationWarning, match="torch.jit"):
        policy = torch.jit.load(str(G1 / "motion.pt"))
    kp, kd = np.array([100, 100, 100, 150, 40, 40.0] * 2), np.array([2, 2, 2, 4, 2, 2.0] * 2)
    pose, action, matrix = np.array([-0.1, 0, 0, 0.3, -0.2, 0] * 2), np.zeros(12), np.zeros(9)
    for tick in range(len(trace.times)):
        assert np.array_equal(data.qpos[7:], trace["q"][tick])
        assert np.array_equal(data.qvel[6:], trace["dq"][tick])
        assert np.array_equal(data.qpos[3:7], trace["quaternion"][tick])
        mujoco.mju_quat2Mat(matrix, data.qpos[3:7])
        phase = 2 * pi * 0.02 / 0.8 + 2 * pi * (1 / 0.8) * 0.02 * tick
        observed = np.concatenate([
            0.25 * data.qvel[3:6], -matrix.reshape(3, 3)[2], [0.5 * 2, 0, 0], data.qpos[7:] - pose,
            0.05 * data.qvel[6:], action, [sin(phase), cos(phase)],
        ]).astype(np.float32)  # fmt: skip
        assert np.array_equal(observed, trace["obs"][tick].astype(np.float32))
        with torch.inference_mode():
            action = policy(torch.from_numpy(observed[None])).numpy()[0].astype(float)
        assert np.array_equal(action, trace["action"][tick])
        target = 0.25 * action + pose
        for _ in range(10):
            data.ctrl[:] = kp * (target - data.qpos[7:]) - kd * data.qvel[6:]
            mujoco.mj_step(model, data)
    assert trace["vx"][trace.times >= 2].mean() == pytest.approx(0.5, abs=0.08)


def test_one_rollout_of_a_recurrent_policy_leaves_nothing_for_the_next(tmp_path):
    backend = opened(tmp_path, LSTM).with_duration(1.0)
    first = backend.rollout({"vd": 0.5}, 0)
    backend.rollout({"vd": 1.0}, 1)
    assert same(first, backend.rollout({"vd": 0.5}, 0))


def test_a_deploy_file_of_another_robot_names_the_counts(tmp_path):
    with pytest.raises(UsageError) as caught:
        opened(tmp_path, LSTM.replace(f"{G1}/g1.yaml", f"{LAB}/deploy.yaml"))
    assert states(str(caught.value), "deploy.yaml", "29 joints", "12 actuators")


@pytest.mark.parametrize(("text", "joints"), [(GO1, 12), (BERKELEY, 12), (G1_LAB, 29), (LSTM, 12)])
def test_each_moves_its_joints_in_the_air(tmp_path, text, joints):
    backend = opened(tmp_path, text)
    trace = backend.run("steps", {}, 0)
    assert (np.ptp(trace["q"], axis=0) > 0.03).all()
    assert backend.play(trace.between(1.0, 2.0).shift(-1.0), {}, 0)["q"].shape == (51, joints)
    assert len(backend.residuals(trace).channels) == joints
