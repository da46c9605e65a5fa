"""The `gym` backend: environments, policies of every form, and wrong inputs."""

import pickle
import zipfile

import gymnasium
import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from s2r_gym.backend import GymBackend
from s2r_spec.backend import Needs, Parameter
from s2r_spec.errors import BackendError, UsageError
from tests.errors import naming

SWING_UP = """\
from math import atan2


def act(observation):
    c, s, speed = observation
    if c > 0.95:
        return -16 * atan2(s, c) - 4 * speed
    return -speed * (0.5 * speed**2 + 15 * (c - 1))
"""
PENDULUM = "Pendulum-v1,policy=pd.py:act"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pd.py").write_text(SWING_UP)
    return tmp_path


def write(name, text):
    with open(name, "w") as file:
        file.write(text)


def test_a_rollout_is_gymnasium_s_own():
    robot = GymBackend(PENDULUM).with_duration(2.0)
    trace = robot.rollout({"m": 1.1, "g": 9.0}, 5)
    assert robot.step == 0.05
    np.testing.assert_allclose(trace.times, np.arange(41) * 0.05)
    environment = gymnasium.make("Pendulum-v1", g=9.0)
    environment.unwrapped.m = 1.1
    observation, _ = environment.reset(seed=5)
    for k in range(40):
        np.testing.assert_array_equal(trace["obs"][k], observation)
        observation, reward, *_ = environment.step(np.array([trace["action"][k]], np.float32))
        assert trace["reward"][k] == reward
    np.testing.assert_array_equal(trace["theta_dot"], trace["obs"][:, 2])
    assert trace.units["theta_dot"] == "rad/s"
    assert abs(trace["action"]).max() == 2.0  # within the bounds, as Pendulum applies it
    assert trace["cos_theta"][-1] > -1
    assert trace.failure is None


def test_every_rollout_is_new_and_an_option_makes_a_twin():
    robot, twin = GymBackend(PENDULUM), GymBackend(f"{PENDULUM},m=1.2")
    first = robot.rollout({"m": 1.2}, 1)
    robot.rollout({"m": 0.9, "l": 1.3}, 2)
    for again in (robot.rollout({"m": 1.2}, 1), twin.rollout({}, 1)):
        np.testing.assert_array_equal(again["obs"], first["obs"])
    assert not np.array_equal(robot.rollout({}, 1)["obs"], first["obs"])
    assert robot.model_hash == GymBackend(PENDULUM).model_hash != twin.model_hash
    before = robot.model_hash
    write("pd.py", SWING_UP.replace("0.95", "0.9"))
    assert robot.model_hash != before
    assert not np.array_equal(robot.rollout({}, 1)["action"], twin.rollout({}, 1)["action"])


def test_the_description_runs_no_code_of_the_policy():
    write("pd.py", "raise SystemExit\ndef act(observation): return 0.0\n")
    robot = GymBackend(PENDULUM)
    assert robot.channels
    assert robot.model_hash
    assert robot.assumptions == ()
    with pytest.raises(UsageError, match=naming("pd.py", "SystemExit")):
        robot.rollout({}, 0)


def test_numbers_that_the_constructor_computes_from_a_changed_one_change_with_it():
    write("pd.py", "def act(observation): return int(observation[2] + 0.5 * observation[3] > 0)")
    trace = GymBackend("CartPole-v1,policy=pd.py:act").with_duration(1.0).rollout({"masspole": 0.5}, 0)
    environment = gymnasium.make("CartPole-v1").unwrapped
    environment.masspole, environment.total_mass, environment.polemass_length = 0.5, 1.5, 0.25
    observation, _ = environment.reset(seed=0)
    for k in range(50):
        np.testing.assert_array_equal(trace["obs"][k], observation)
        observation, *_ = environment.step(int(trace["action"][k]))
    write("pd.py", SWING_UP)
    limited = GymBackend(f"{PENDULUM},max_torque=1").rollout({}, 4)
    assert abs(limited["action"]).max() == 1.0


def test_termination_is_a_failure_and_a_time_limit_is_none():
    write("pd.py", "def act(observation): return 1")
    robot = GymBackend("CartPole-v1,policy=pd.py:act")
    assert robot.duration == 10.0
    trace = robot.rollout({}, 0)
    assert trace.failure == "terminated"
    assert trace.times[-1] < 1.0
    assert abs(trace["theta"][-1]) > 0.2
    with pytest.raises(
        UsageError, match=naming("CartPole-v1", "500", "10 s", "12 s", "max_episode_steps=600")
    ):
        robot.with_duration(12.0)
    longer = GymBackend("CartPole-v1,policy=pd.py:act,max_episode_steps=600").with_duration(12.0)
    assert longer.rollout({}, 0).failure == "terminated"


COUNTERS = """\
class Counts:
    def __init__(self):
        self.calls = 0

    def act(self, observation):
        self.calls += 1
        return 0.01 * self.calls


class Resets(Counts):
    def reset(self):
        self.calls = 0


one = Resets()
"""


@pytest.mark.parametrize("name", ["Counts", "one"])
def test_a_class_begins_anew_and_an_object_is_reset(name):
    write("pd.py", COUNTERS)
    robot = GymBackend(f"Pendulum-v1,policy=pd.py:{name}").with_duration(0.2)
    for _ in range(2):
        np.testing.assert_allclose(robot.rollout({}, 0)["action"], [0.01, 0.02, 0.03, 0.04, 0.04], rtol=1e-6)


def save_linear(path, weights, output="actions"):
    """Save a policy in ONNX that multiplies an observation (inputs,) with weights (inputs, outputs)."""
    inputs, outputs = weights.shape
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "w"], [output])], "policy",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info(output, TensorProto.FLOAT, [1, outputs])],
        [numpy_helper.from_array(weights.astype(np.float32), "w")],
    )  # fmt: skip
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)


def test_an_onnx_policy_gives_an_action_or_the_largest_of_discrete_ones():
    save_linear("pd.onnx", np.array([[0.0], [0.5], [0.25]]))
    trace = GymBackend("Pendulum-v1,policy=pd.onnx").with_duration(0.5).rollout({}, 0)
    np.testing.assert_allclose(trace["action"][0], trace["obs"][0] @ [0.0, 0.5, 0.25], rtol=1e-6)
    save_linear("pole.onnx", np.array([[0.0, 0.0], [0.0, 0.0], [-1.0, 1.0], [-0.5, 0.5]]))
    trace = GymBackend("CartPole-v1,policy=pole.onnx").with_duration(2.0).rollout({}, 0)
    np.testing.assert_array_equal(trace["action"][:-1], (trace["obs"] @ [0, 0, 1, 0.5] > 0)[:-1])
    with pytest.raises(UsageError, match=naming("pole.onnx", "4", "Pendulum-v1", "3")):
        GymBackend("Pendulum-v1,policy=pole.onnx")
    save_linear("wide.onnx", np.zeros((3, 2)))
    with pytest.raises(UsageError, match=naming("wide.onnx", "2", "Pendulum-v1", "1")):
        GymBackend("Pendulum-v1,policy=wide.onnx")


class Opened:
    def __reduce__(self):
        return open, ("created", "w")


def save_sb3(path, weights):
    """Save a zip as Stable-Baselines3 does, with a pickle that would create a file."""
    torch.save(weights, "policy.pth")
    with zipfile.ZipFile(path, "w") as archive:
        archive.write("policy.pth")
        archive.writestr("data", pickle.dumps(Opened()))
        archive.writestr("pytorch_variables.pth", pickle.dumps(Opened()))


def layer(name, inputs, outputs):
    return {f"{name}.weight": torch.randn(outputs, inputs), f"{name}.bias": torch.randn(outputs)}


PPO = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
SAC = ("actor.latent_pi.0", "actor.latent_pi.2", "actor.mu")
TD3 = ("actor.mu.0", "actor.mu.2", "actor.mu.4")
DQN = ("q_net.q_net.0", "q_net.q_net.2", "q_net.q_net.4")


@pytest.mark.parametrize(("names", "kind"), [(PPO, "PPO"), (SAC, "SAC"), (TD3, "TD3")])
def test_the_weights_of_stable_baselines3(folder, names, kind):
    torch.manual_seed(0)
    weights = (
        layer(names[0], 3, 8) | layer(names[1], 8, 8) | layer(names[2], 8, 1) | {"log_std": torch.zeros(1)}
    )
    save_sb3("policy.zip", weights | layer("critic.qf0.0", 4, 8) | layer("value_net", 8, 1))
    robot = GymBackend("Pendulum-v1,policy=policy.zip").with_duration(0.5)
    trace = robot.rollout({}, 0)
    x = torch.tensor(trace["obs"], dtype=torch.float32)
    hidden = torch.tanh if kind == "PPO" else torch.relu
    for name in names[:2]:
        x = hidden(x @ weights[f"{name}.weight"].T + weights[f"{name}.bias"])
    x = x @ weights[f"{names[2]}.weight"].T + weights[f"{names[2]}.bias"]
    wanted = torch.clamp(x, -2, 2) if kind == "PPO" else 2 * torch.tanh(x)
    np.testing.assert_allclose(trace["action"][:-1], wanted[:-1, 0], rtol=1e-5, atol=1e-6)
    assert kind in " ".join(robot.assumptions)  # its activation
    assert not (folder / "created").exists()


def test_the_weights_of_a_dqn_choose_the_largest_value():
    torch.manual_seed(0)
    save_sb3("policy.zip", layer(DQN[0], 4, 8) | layer(DQN[1], 8, 8) | layer(DQN[2], 8, 2))
    trace = GymBackend("CartPole-v1,policy=policy.zip").with_duration(0.2).rollout({}, 0)
    assert {*trace["action"]} <= {0.0, 1.0}


def test_other_zips_are_refused_and_no_pickle_is_read(folder):
    with zipfile.ZipFile("other.zip", "w") as archive:
        archive.writestr("data", pickle.dumps(Opened()))
    save_sb3(
        "picture.zip", {"features_extractor.cnn.0.weight": torch.zeros(2, 2)} | layer("action_net", 2, 1)
    )
    save_sb3("empty.zip", {})
    with zipfile.ZipFile("evil.zip", "w") as archive:
        archive.writestr("policy.pth", pickle.dumps(Opened()))
    write("text.zip", "no zip")
    for name in ("other", "picture", "empty", "evil", "text"):
        with pytest.raises(UsageError, match=naming(f"{name}.zip")):
            GymBackend(f"Pendulum-v1,policy={name}.zip")
    assert not (folder / "created").exists()


@pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
def test_torchscript():
    torch.manual_seed(0)
    torch.jit.script(torch.nn.Linear(3, 1)).save("policy.pt")
    trace = GymBackend("Pendulum-v1,policy=policy.pt").with_duration(0.2).rollout({}, 0)
    torch.manual_seed(0)
    wanted = torch.nn.Linear(3, 1)(torch.tensor(trace["obs"][:-1], dtype=torch.float32)).detach()
    np.testing.assert_allclose(trace["action"][:-1], wanted[:, 0].clamp(-2, 2), rtol=1e-5)


@pytest.mark.parametrize(
    ("options", "facts"),
    [
        ("", ("gym:Pendulum-v1",)),
        ("Pendulm-v1", ("Pendulm-v1", "Pendulum-v1")),
        ("no_such_module:Walk-v0", ("no_such_module",)),
        ("Blackjack-v1,dt=1", ("Blackjack-v1", "Tuple")),
        ("MountainCar-v0,policy=pd.py:act", ("MountainCar-v0", "dt=SECONDS")),
        ("MountainCar-v0,dt=-1", ("MountainCar-v0", "dt=SECONDS")),
        ("Pendulum-v1,dt=0.01", ("Pendulum-v1", "0.05 s", "dt=0.01")),
        ("Pendulum-v1,max_torqe=1", ("max_torqe", "max_torque")),
        ("Pendulum-v1,m=heavy", ("m", "heavy")),
        ("Pendulum-v1,policy=none.py:act", ("none.py",)),
        ("Pendulum-v1,policy=none.onnx", ("none.onnx",)),
        ("Pendulum-v1,policy=pd.txt", ("pd.txt", "FILE.py:act", ".onnx")),
        ("CartPole-v1,sutton_barto_reward=perhaps", ("sutton_barto_reward", "true")),
    ],
)
def test_a_wrong_option_gets_one_sentence(options, facts):
    with pytest.raises(UsageError, match=naming(*facts)) as raised:
        GymBackend(options)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("code", "facts"),
    [
        ("def act(observation):\n    return 1 / 0", ("ZeroDivisionError", "0 s", "line 2")),
        ("def act(observation): return float('nan')", ("nan", "0 s")),
        ("def act(observation): return [1.0, 2.0]", ("2", "1")),
        ("def act(observation): return 'left'", ("left",)),
        ("def act(): return 0.0", ("TypeError",)),
        ("act = 3", ("int",)),
    ],
)
def test_a_wrong_policy_gets_one_sentence(code, facts):
    write("pd.py", code)
    with pytest.raises((BackendError, UsageError), match=naming("pd.py", *facts)):
        GymBackend(PENDULUM).rollout({}, 0)


def test_a_wrong_test_or_action_gets_one_sentence():
    with pytest.raises(UsageError, match=naming("mm", "m")):
        GymBackend(PENDULUM).rollout({"mm": 1.0}, 0)
    needs = Needs((), (Parameter("m", "kg", 0.9, 3.0, 0.9, ""),), lambda trace, params: 0.0)
    with pytest.raises(UsageError, match=naming("policy=FILE.py:act")):
        GymBackend("Pendulum-v1").for_spec(needs)
    declared = {one.name: one for one in GymBackend(PENDULUM).for_spec(needs).parameters}
    assert declared["m"].high == 3.0
    assert declared["m"].unit == "kg"
    assert "l" in declared
    write("pd.py", "def act(observation): return 2")
    with pytest.raises(BackendError, match=naming("pd.py", "2", "0", "1")):
        GymBackend("CartPole-v1,policy=pd.py:act").rollout({}, 0)
    write("pd.py", "def act(observation): return 0.0")
    car = GymBackend("MountainCarContinuous-v0,policy=pd.py:act,dt=0.02").with_duration(0.1)
    assert car.rollout({}, 0).duration == pytest.approx(0.1)
