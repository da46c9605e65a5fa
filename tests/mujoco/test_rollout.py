"""A rollout is a function of parameters and seed; its start, its fields, its pushes and its failures."""

import mujoco
import numpy as np
import pytest

import s2r_spec
from s2r_spec.backend import load_backend
from s2r_spec.errors import UsageError
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.task import Done, Task, run_task
from tests import forked
from tests.errors import naming
from tests.mujoco.robots import opened, quadruped, robot, same, weights

TERMS = (
    'observation = ["joint_pos", "base_ang_vel"]\naction = { scale = 0.3, stiffness = 20, damping = 0.5 }\n'
)
BASE = f"decimation = 4\nduration = 0.4\n{TERMS}"
FIELDS = """\
parameters.payload = { field = "body/load/mass", unit = "kg" }
parameters.grip = { field = "geom/floor/friction/0", how = "scale", range = [0.2, 2] }
parameters.rub = { field = "joint/f?/frictionloss", how = "add", range = [0, 3] }
parameters.kick = { push = "trunk", at = "0.1 s", for = "0.06 s", range = [-100, 100], direction = [0, 2, 0] }
"""
LOADED = quadruped().replace(
    '<site name="imu"',
    '<body name="load" pos="0 0 0.1"><inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/>'
    '</body><site name="imu"',
)
NOISE = "start.noise = { joint_pos = 0.05, joint_vel = 0.5, base_ang_vel = 0.2 }\n"


def test_a_rollout_depends_on_parameters_and_seed_alone(tmp_path):
    backend = robot(tmp_path, BASE + FIELDS + NOISE, 7, LOADED)
    test = {"payload": 0.9, "grip": 0.5, "rub": 0.4, "kick": 30.0}
    first = backend.rollout(test, 3)
    others = [backend.rollout({**test, name: value}, 3) for name, value in
              (("payload", 0.1), ("grip", 2.0), ("rub", 0.0), ("kick", 0.0))]  # fmt: skip
    others.append(backend.rollout(test, 4))
    assert not any(same(first, other) for other in others)
    assert same(first, backend.rollout(test, 3))
    again = load_backend(backend.name)
    assert again.model_hash == backend.model_hash
    assert same(first, again.rollout(test, 3))
    there, _ = forked.Afresh()(Task(0, 0, backend.name, test, 3, duration=backend.duration))
    assert same(first, there)
    assert {"params", "seed", "model_hash", "backend"} <= {*first.meta}


def test_a_default_value_is_the_same_as_no_value(tmp_path):
    backend = robot(tmp_path, BASE + FIELDS + NOISE, 7, LOADED)
    test = {one.name: one.default for one in backend.parameters}
    assert test == {"payload": 0.5, "grip": 1.0, "rub": 0.0, "kick": 0.0}
    found = backend.rollout(test, 3)
    bare = robot(tmp_path, BASE + NOISE, 7, LOADED)
    assert same(found, bare.rollout({}, 3))
    assert backend.model_hash != bare.model_hash


def lstm_like(path):
    """Write a TorchScript policy whose buffer adds up what it reads."""
    torch = pytest.importorskip("torch")

    class Sums(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.register_buffer("state", 0.25 * torch.ones(1, 7))
            self.register_buffer("W", torch.tensor(weights(4, 7, 0.03), dtype=torch.float32))

        def forward(self, obs):
            self.state[:] = 0.9 * self.state + obs
            return self.state @ self.W.T

    with pytest.warns(DeprecationWarning, match="torch.jit"):
        torch.jit.save(torch.jit.script(Sums()), str(path))


def onnx_sums(path):
    """Write the same as ONNX with the state as input ``h_in`` and output ``h_out``, which begins at zero."""
    from onnx import TensorProto, helper, numpy_helper

    def value(name, width):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width])

    nodes = [
        helper.make_node("Mul", ["h_in", "keep"], ["kept"]),
        helper.make_node("Add", ["kept", "obs"], ["h_out"]),
        helper.make_node("Gemm", ["h_out", "W"], ["actions"], transB=1),
    ]
    constants = [
        numpy_helper.from_array(np.float32([0.9]), "keep"),
        numpy_helper.from_array(weights(4, 7, 0.03).astype(np.float32), "W"),
    ]
    ends = [value("obs", 7), value("h_in", 7)], [value("actions", 4), value("h_out", 7)]
    model = helper.make_model(
        helper.make_graph(nodes, "g", *ends, constants),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=9,
    )
    path.write_bytes(model.SerializeToString())


@pytest.mark.parametrize(
    ("name", "write", "first"), [("policy.pt", lstm_like, 0.25), ("policy.onnx", onnx_sums, 0)]
)
def test_a_hidden_state_begins_anew_in_every_rollout(tmp_path, name, write, first):
    """Its value in the file for TorchScript, zeros for ONNX; it then adds up the observations of one rollout."""
    write(tmp_path / name)
    (tmp_path / "box.xml").write_text(quadruped())
    backend = opened(tmp_path, f'model = "box.xml"\npolicy = "{name}"\n{BASE}{NOISE}')
    trace = backend.rollout({}, 3)
    state, wanted = np.full(7, first), []
    for observation in trace["obs"]:
        state = 0.9 * state + observation
        wanted.append(weights(4, 7, 0.03) @ state)
    np.testing.assert_allclose(trace["action"], wanted, rtol=1e-5, atol=1e-6)
    backend.rollout({}, 4)
    assert same(trace, backend.rollout({}, 3))
    assert any("recurrent" in one.words for one in backend.preflight(run=False) if one.topic == "files")


def test_noise_comes_from_the_seed_and_a_deviation_of_zero_changes_no_other_number(tmp_path):
    def start(noise, seed=3):
        trace = robot(tmp_path, f"{BASE}start = {{ height = 1, noise = {noise} }}\n", 7).rollout({}, seed)
        return {name: trace[name][0] for name in ("q", "dq", "velocity", "omega", "z")}

    one = start("{ joint_pos = 0.1, joint_vel = 1, base_lin_vel = 0.5, base_ang_vel = 0.25 }")
    other = start("{ joint_pos = 0.2, joint_vel = 0, base_lin_vel = 0.5 }")
    assert other["q"] == pytest.approx(2 * one["q"])
    assert (other["dq"] == 0).all()
    assert (other["omega"] == 0).all()
    assert np.array_equal(other["velocity"], one["velocity"])
    assert one["z"] == other["z"] == 1
    assert np.abs(one["velocity"] / 0.5 - one["omega"] / 0.25).min() > 1e-3
    assert not np.array_equal(start("{ joint_pos = 0.1 }", 4)["q"], one["q"])
    assert (start("{}")["q"] == 0).all()
    backend = robot(tmp_path, f"{BASE}start.noise.joint_pos = 0.1\n", 7).with_duration(0.02)
    many = np.concatenate([backend.rollout({}, seed)["q"][0] for seed in range(40)])
    assert np.std(many) == pytest.approx(0.1, rel=0.2)
    assert np.mean(many) == pytest.approx(0, abs=0.03)


KEYS = """<keyframe>
  <key name="crouch" qpos="0 0 0.4 1 0 0 0 0.5 0.5 -0.5 -0.5" ctrl="0 0 0 0"/>
  <key name="home" qpos="0 0 0.3 1 0 0 0 0.1 0.2 0.3 0.4"/>
</keyframe>"""


@pytest.mark.parametrize(
    ("toml", "q", "z"),
    [
        ("", [0.1, 0.2, 0.3, 0.4], 0.3),
        ('keyframe = "crouch"\n', [0.5, 0.5, -0.5, -0.5], 0.4),
        ('start.joint_pos = "model"\n', [0, 0, 0, 0], 0.25),
        ('start.joint_pos = "keyframe"\nkeyframe = "crouch"\n', [0.5, 0.5, -0.5, -0.5], 0.4),
        ('start.joint_pos = "default"\n', [0.1, 0.2, 0.3, 0.4], 0.02 + 0.2 * np.cos(0.1)),
        ("start = { joint_pos = { fl = 1.2, fr = 1.2, rl = 1.2, rr = 1.2 } }\n", [1.2] * 4, 0.02 + 0.2 * np.cos(1.2)),
        ("start = { joint_pos = { rr = -0.2 }, height = 0.7 }\n", [0.1, 0.2, 0.3, -0.2], 0.7),
        ("default_joint_pos = { 'f.' = 0.6, 'r.' = 0.7 }\n", [0.6, 0.6, 0.7, 0.7], 0.02 + 0.2 * np.cos(0.6)),
        ("default_joint_pos = 1.45\n", [1.45] * 4, 0.05),
    ],
)  # fmt: skip
def test_the_start_is_a_keyframe_or_a_pose_on_its_lowest_geom(tmp_path, toml, q, z):
    """A capsule is lowest, or the box where the legs are up."""
    trace = robot(tmp_path, BASE + toml, 7, quadruped(extra=KEYS)).rollout({}, 0)
    assert trace["q"][0] == pytest.approx(q)
    assert trace["z"][0] == pytest.approx(z, abs=1e-6)


def test_the_floor_may_be_higher_and_a_visual_geom_touches_nothing(tmp_path):
    visual = '<geom type="sphere" size="0.5" contype="0" conaffinity="0" mass="0"/>'
    model = quadruped(extra='<worldbody><geom type="box" size="1 1 1" pos="9 9 0"/></worldbody>')
    model = model.replace('size="0 0 0.1"', 'size="0 0 0.1" pos="0 0 0.5"')
    model = model.replace('<site name="imu"', f'{visual}<site name="imu"')
    trace = robot(tmp_path, BASE + 'start.joint_pos = "default"\n', 7, model).rollout({}, 0)
    assert trace["z"][0] == pytest.approx(0.72, abs=1e-6)
    assert trace["height"][0] == pytest.approx(0.22, abs=1e-6)


@pytest.mark.parametrize(
    ("toml", "step", "samples"),
    [("decimation = 4", 0.02, 21), ("decimation = 10", 0.05, 9), ("decimation = 3\ntimestep = 0.001", 0.003, 135)],
)  # fmt: skip
def test_samples_come_every_control_period(tmp_path, toml, step, samples):
    """The duration is rounded up to whole periods."""
    backend = robot(tmp_path, f"{toml}\nduration = 0.4\n{TERMS}", 7)
    trace = backend.rollout({}, 0)
    np.testing.assert_allclose(trace.times, step * np.arange(samples), rtol=1e-12)
    assert backend.duration == pytest.approx(trace.times[-1])
    longer = backend.with_duration(0.5)
    assert longer.duration == pytest.approx(step * np.ceil(0.5 / step - 1e-9))
    assert longer.rollout({}, 0).times[-1] == pytest.approx(longer.duration)
    assert np.array_equal(longer.rollout({}, 0)["q"][:samples], trace["q"])


def test_a_floating_body_falls_as_newton_says(tmp_path):
    """Control periods of other lengths, and a smaller physics step, change nothing in free flight."""
    for toml in ("decimation = 4", "decimation = 1\ntimestep = 0.001"):
        trace = robot(tmp_path, f"{toml}\nduration = 0.3\n{TERMS}start.height = 2\n", 7).rollout({}, 0)
        np.testing.assert_allclose(trace["z"][-1], 2 - 9.81 / 2 * trace.times[-1] ** 2, atol=0.01)


def test_fields_are_set_added_and_scaled(tmp_path):
    """A test is the rollout of a model whose file has the values."""
    backend = robot(tmp_path, BASE + FIELDS + NOISE, 7, LOADED)
    found = backend.rollout({"payload": 2.0, "grip": 0.5, "rub": 0.3}, 3)
    model = LOADED.replace('mass="0.5"', 'mass="2"').replace(
        'size="0 0 0.1"', 'size="0 0 0.1" friction="0.5"'
    )
    for leg in ("fl", "fr"):
        model = model.replace(f'<joint name="{leg}"', f'<joint frictionloss="0.3" name="{leg}"')
    assert same(found, robot(tmp_path, BASE + NOISE, 7, model).rollout({}, 3))


def test_a_push_gives_the_momentum_of_force_times_time(tmp_path):
    """In free flight the common centre of mass keeps it: 100 N over three control periods."""
    backend = robot(tmp_path, BASE + FIELDS + "start.height = 3\n", 7, LOADED)
    model = mujoco.MjModel.from_xml_string(LOADED)
    free, pushed = backend.rollout({"kick": 0.0}, 0), backend.rollout({"kick": 100.0}, 0)
    mass = model.body_subtreemass[model.body("trunk").id]
    data = mujoco.MjData(model)

    def momentum(trace, k):
        data.qpos[:3] = [trace[name][k] for name in "xyz"]
        data.qpos[3:7], data.qpos[7:] = trace["quaternion"][k], trace["q"][k]
        mujoco.mju_rotVecQuat(data.qvel[:3], np.array(trace["velocity"][k]), np.array(trace["quaternion"][k]))
        data.qvel[3:6], data.qvel[6:] = trace["omega"][k], trace["dq"][k]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        return mass * data.subtree_linvel[model.body("trunk").id]

    change = [momentum(pushed, k) - momentum(free, k) for k in (5, 6, 8, -1)]
    np.testing.assert_allclose(change, [[0, 0, 0], [0, 2, 0], [0, 6, 0], [0, 6, 0]], atol=0.02)


def test_a_failure_ends_the_trace_at_its_first_sample(tmp_path):
    toml = (
        BASE + 'start.height = 1\nfailure.low = "height < 0.8"\nfailure.fast = "abs(vz) > 100 {cm/s}"\n'
        'failure.sunk = "height < 0.7 * init(height)"\n'
    )
    backend = robot(tmp_path, toml, 7)
    free = robot(tmp_path, BASE + "start.height = 1\n", 7).rollout({}, 0)
    backend = robot(tmp_path, toml, 7)
    trace = backend.rollout({}, 0)
    last = int(np.argmax((free["height"] < 0.8) | (np.abs(free["vz"]) > 1)))
    assert trace.meta["failure"] == "fast"
    assert len(trace.times) == last + 1 < len(free.times)
    for name in free.channels:
        assert np.array_equal(trace[name], free[name][: last + 1])


def test_a_failure_gives_the_value_of_a_fall_in_a_check(tmp_path):
    backend = robot(tmp_path, BASE + FIELDS.replace(', unit = "kg"', ", range = [0.1, 9]") + (
        'start.height = 1\nfailure.low = "height < 0.8"\n'), 7, LOADED)  # fmt: skip
    spec = s2r_spec.parse_spec(
        "signal height {m}\nparam payload {kg} in [0.1, 9]\nrequire up: always[0 s, 0.4 s] (height > 0.1 {m})\n"
        "certify up: delta = 0.05, epsilon = 0.1, B = 1, R = 0.02, kernel = rbf(5 {kg}), fall = -0.75\n"
    )
    scorer = Scorer.for_spec(spec, "up", backend.name)
    task = scorer.task(0, 0, {"payload": 1.0}, 7)
    assert scorer.score({"payload": 1.0}, Done(task, *run_task(task))) == (-0.75, "low")


def test_an_unstable_rollout_ends_at_its_last_good_state_and_is_not_begun_again(tmp_path):
    """MuJoCo would put the robot back to its start and go on."""
    toml = BASE.replace("action = {", 'action = { pd = "explicit",').replace("damping = 0.5", "damping = 50")
    backend = robot(tmp_path, toml + NOISE, 7)
    trace = backend.rollout({}, 0)
    assert trace.meta["failure"] == "unstable"
    assert 1 < len(trace.times) < 21
    assert all(np.isfinite(trace[name]).all() for name in ("q", "dq", "z"))
    assert np.abs(trace["dq"]).max() <= 1e10
    assert np.abs(trace["dq"][-1]).max() > 1e2
    assert same(trace, backend.rollout({}, 0))


def test_a_range_comes_from_the_spec_where_no_file_states_one(tmp_path):
    """In the spec's own unit."""
    backend = robot(tmp_path, BASE + FIELDS, 7, LOADED)
    spec = s2r_spec.parse_spec(
        "signal height {m}\nparam payload {g} in [200, 2500]\nrequire up: always[0 s, 0.2 s] (height > 0.1 {m})\n"
        "certify up: fall = -1\n"
    )
    scorer = Scorer.for_spec(spec, "up", backend.name)
    payload = {one.name: one for one in scorer.backend.parameters}["payload"]
    assert (payload.low, payload.high, payload.default, payload.unit) == (0.2, 2.5, 0.5, "kg")
    task = scorer.task(0, 0, {"payload": 2500.0}, 7)
    trace = run_task(task)[0]
    assert np.array_equal(trace["height"], scorer.backend.rollout({"payload": 2.5}, 7)["height"])


@pytest.mark.parametrize(
    ("test", "facts"),
    [
        ({"grip": 3.0}, ["grip", "3", "2"]),
        ({"grap": 1.0}, ["'grap'", "did you mean 'grip'"]),
        ({"payload": float("nan")}, ["payload", "nan"]),
        ({"leg": -1.0}, ["box.xml", "geom/fl/mass", "-1"]),
    ],
)
def test_a_test_outside_of_the_ranges_is_refused(tmp_path, test, facts):
    backend = robot(tmp_path, BASE + FIELDS + 'parameters.leg.field = "geom/fl/mass"\n', 7, LOADED)
    with pytest.raises(UsageError, match=naming(*facts)):
        backend.rollout(test, 0)


def test_an_option_is_another_default(tmp_path):
    backend = robot(tmp_path, BASE + FIELDS, 7, LOADED)
    twin = load_backend(f"{backend.name}:payload=1.5")
    assert twin.name == f"{backend.name}:payload=1.5"
    assert twin.model_hash != backend.model_hash
    assert same(twin.rollout({}, 1), backend.rollout({"payload": 1.5}, 1)) is True
    assert {one.name: one.default for one in twin.parameters}["payload"] == 1.5
    with pytest.raises(UsageError, match=naming("'paylod'", "payload")):
        load_backend(f"{backend.name}:paylod=1.5")
    with pytest.raises(UsageError, match=naming("grip", "5")):
        load_backend(f"{backend.name}:grip=5")


def test_the_pre_flight_names_a_parameter_without_an_effect(tmp_path):
    """A push after the end, and a field that a motor does not read."""
    late = 'parameters.late = { push = "trunk", at = "9 s", range = [0, 90] }\n'
    bias = 'parameters.bias = { field = "actuator/*/biasprm/1", range = [0, 1] }\n'
    backend = robot(tmp_path, f"{BASE}{FIELDS}{late}{bias}", 7, LOADED)
    found = [
        one for one in backend.preflight(run=True) if one.topic == "parameters" and "nothing" in one.words
    ]
    assert [one.words.split()[0] for one in found] == ["late", "bias"]


def test_the_time_step_is_no_parameter_of_a_test(tmp_path):
    with pytest.raises(UsageError, match=naming("parameters.dt", "`timestep`")):
        robot(tmp_path, BASE + 'parameters.dt.field = "option/timestep"\n', 7)


def test_pushes_on_one_body_add_up(tmp_path):
    push = 'parameters.{} = {{ push = "trunk", at = "{} s", for = "0.1 s", range = [-99, 99] }}\n'
    toml = BASE + "start.height = 3\n" + push.format("a", 0.1) + push.format("b", 0.1) + push.format("c", 0.3)
    backend = robot(tmp_path, toml, 7)
    np.testing.assert_allclose(
        backend.rollout({"a": 20.0, "b": 10.0}, 0)["vx"], backend.rollout({"a": 30.0}, 0)["vx"], atol=1e-9
    )
    assert backend.rollout({"a": 20.0, "c": -20.0}, 0)["x"][-1] > 0.05
