"""Wrong input of each kind: one sentence that names file and key, and says what to do."""

import re

import numpy as np
import pytest

from s2r_spec.backend import load_backend
from s2r_spec.errors import BackendError, UsageError
from tests.errors import naming, states
from tests.mujoco.make_policies import linear
from tests.mujoco.robots import opened, quadruped, robot, save, weights

BASE = 'decimation = 4\nduration = 0.1\nobservation = ["joint_pos"]\n'
FLOOR = '<geom name="floor" type="plane" size="0 0 0.1"/>'
MESH = quadruped().replace("<worldbody>", '<asset><mesh name="m" file="shell.stl"/></asset><worldbody>')
HOME = '<keyframe><key name="home" qpos="0 0 1 1 0 0 0 0 0 0 0"/>{}</keyframe>'
UNNAMED = '<keyframe><key qpos="0 0 1 1 0 0 0 0 0 0 0"/><key qpos="0 0 2 1 0 0 0 0 0 0 0"/></keyframe>'


def instead(term):
    return BASE.replace('"joint_pos"', term)


def refusal(folder, toml=BASE, width=4, model=None, outputs=4, kind=UsageError):
    """Return the sentence with which a robot is refused when it is opened or prepared, without its folder."""
    with pytest.raises(kind) as caught:
        robot(folder, toml, width, model, outputs).prepare()
    sentence = str(caught.value).replace(f"{folder}/", "")
    assert "\n" not in sentence
    assert "pydantic" not in sentence
    assert "Input should" not in sentence
    return sentence


MODELS = [
    (quadruped()[:-12], ["box.xml", "XML", "line 18"]),
    (quadruped().replace("<worldbody>", '<include file="legs.xml"/><worldbody>'), ["box.xml", "legs.xml"]),
    (quadruped().replace("<motor ", "<moter "), ["box.xml", "moter"]),
    (MESH.replace("<site", '<geom type="mesh" mesh="m"/><site'), ["box.xml", "shell.stl", "collision"]),
    (MESH.replace("<site", '<geom type="mesh" mesh="m" contype="0" conaffinity="0"/><site'),
     ["box.xml", "shell.stl", "mass"]),
    (quadruped().replace(FLOOR, ""), ["robot.toml", "floor = true"]),
    (quadruped(actuator=" "), ["robot.toml", "no actuators"]),
    (quadruped(extra=HOME.format('<key name="up" qpos="0 0 2 1 0 0 0 0 0 0 0"/>')).replace('"home"', '"low"'),
     ["2 keyframes", "low, up", "`keyframe`"]),
    (quadruped(extra=UNNAMED), ["robot.toml", "2 keyframes", "name", "`keyframe`"]),
]  # fmt: skip


@pytest.mark.parametrize(("model", "facts"), MODELS)
def test_a_model_that_lacks_something(tmp_path, model, facts):
    assert states(refusal(tmp_path, model=model), *facts)


def test_a_mesh_for_pictures_alone_may_be_missing_and_a_floor_may_be_added(tmp_path):
    inertial = '<inertial pos="0 0 0" mass="3" diaginertia="0.1 0.1 0.1"/>'
    visual = f'{inertial}<geom type="mesh" mesh="m" contype="0" conaffinity="0"/><site'
    model = MESH.replace("<site", visual).replace(FLOOR, "")
    trace = robot(tmp_path, "floor = true\n" + BASE, 4, model).rollout({}, 0)
    assert trace["height"][0] == pytest.approx(0.22)
    assert np.abs(trace["vz"][-1]) < 0.5


TERMS = [
    ('"joint_poss"', ["observation[0]", "'joint_poss'", "did you mean 'joint_pos'"]),
    ('"gyro"', ["observation[0]", '{ sensor = "gyro" }']),
    ('"phase"', ["observation[0]", "{ phase = 1.5"]),
    ('{ term = "sensor" }', ["observation[0]", '{ sensor = "NAME" }']),
    ('{ sensor = "giro" }', ["observation[0]", "'giro'", "did you mean 'gyro'"]),
    ('"joint_vel", { term = "base_lin_vel", frame = "imo" }', ["observation[1]", "'imo'", "did you mean 'imu'"]),
    ('{ term = "joint_pos", joints = ["fx"] }', ["observation[0]", "'fx'", "fl, fr, rl, rr"]),
    ('{ term = "joint_pos", joints = ["f("] }', ["observation[0]", "'f('", "regular expression"]),
    ('{ term = "joint_pos", scale = [1, 2] }', ["observation[0]", "2", "4", "joint_pos"]),
    ('{ term = "joint_pos", clip = [2, 1] }', ["observation[0].clip", "2", "1"]),
    ('{ term = "joint_pos", sensor = "gyro" }', ["observation[0]", "exactly one of term, sensor and phase"]),
    ('{ scale = 2 }', ["observation[0]", "exactly one of term, sensor and phase"]),
    ('{ term = "joint_pos", scal = 2 }', ["observation[0].scal", "did you mean 'scale'"]),
    ('{ term = "joint_pos", history = 0 }', ["observation[0].history", "1", "0"]),
    ('{ term = "joint_pos", history = 100000000 }', ["observation[0].history", "1000"]),
    ('{ phase = -1 }', ["observation[0].phase", "-1"]),
    ('{ phase = 1, as = ["tan"] }', ["observation[0].as[0]", "'sin' or 'cos'", "'tan'"]),
    ('{ phase = 1, unit = "ms" }', ["observation[0].unit", "'Hz' or 's'"]),
    ('{ term = "base_ang_vel", joints = ["fl"] }', ["observation[0]", "'base_ang_vel'", "joints"]),
    ('{ term = "joint_pos", frame = "world" }', ["observation[0]", "'joint_pos'", "frame"]),
    ('{ term = "joint_pos", start = 1 }', ["observation[0]", "'joint_pos'", "start"]),
    ('3', ["observation[0]", "text", "3"]),
    ('"joint_pos", "base_ang_vel"', ["policy.onnx", "4", "7", "joint_pos 4, base_ang_vel 3"]),
    ('{ term = "joint_pos", history = 2 }', ["policy.onnx", "4", "8", "joint_pos 8"]),
]  # fmt: skip


@pytest.mark.parametrize(("terms", "facts"), TERMS)
def test_a_wrong_term(tmp_path, terms, facts):
    assert states(refusal(tmp_path, instead(terms)), *facts)


KEYS = [
    ("polcy = 1", ["polcy", "did you mean 'policy'"]),
    ("action.scal = 1", ["action.scal", "did you mean 'scale'"]),
    ("start.hight = 1", ["start.hight", "did you mean 'height'"]),
    ("start.noise.joint_poss = 1", ["start.noise.joint_poss", "did you mean 'joint_pos'"]),
    ('parameters.m = { feild = "geom/fl/mass" }', ["parameters.m.feild", "did you mean 'field'"]),
    ('command.lin_vel = "vd"', ["command.lin_vel", "lin_vel_x"]),
    ('command.lin_vel_x = { paramter = "vd" }', ["command.lin_vel_x.paramter", "did you mean 'parameter'"]),
    ("command.lin_vel_x = [1]", ["command.lin_vel_x", "number", "[1]"]),
    ("command.lin_vel_x = inf", ["command.lin_vel_x", "finite", "inf"]),
    ('action.scale = "a"', ["action.scale", "list", "'a'"]),
    ("action = { stiffness = -5, damping = 1 }", ["action.stiffness", "0"]),
    ("action.damping = 1", ["action.damping", "action.stiffness"]),
    ('action.pd = "implicit"', ["action.pd", "action.stiffness"]),
    ('action.pd = "explict"', ["action.pd", "'explicit' or 'implicit'", "'explict'"]),
    ("action.clip = [2, 1]", ["action.clip", "2", "1"]),
    ("action.stiffness = [1, 2, 3]", ["action.stiffness", "3", "4"]),
    ("action.stiffness = { 'f.' = 1, fl = 2, 'r.' = 1 }", ["action.stiffness", "'f.' and 'fl'", "fl"]),
    ("action.stiffness = { 'f.' = 1 }", ["action.stiffness", "rl"]),
    ("action.scale = { '.*' = 1, xx = 2 }", ["action.scale", "'xx'", "fl, fr, rl, rr"]),
    ('action.joints = ["fl", "fx"]', ["action.joints", "'fx'", "fl, fr, rl, rr"]),
    ('action.joints = ["fl", "fl"]', ["action.joints", "'fl'", "twice"]),
    ('action.joints = ["fl", "fr"]', ["policy.onnx", "4", "2"]),
    ("default_joint_pos = [1, 2]", ["default_joint_pos", "2", "4"]),
    ("default_joint_pos = 3", ["default_joint_pos", "3", "fl", "[-1.2, 1.5]"]),
    ('keyframe = "home"', ["robot.toml", "'home'"]),
    ('start.joint_pos = "hoem"', ["start.joint_pos", "'default', 'keyframe' or 'model'", "'hoem'"]),
    ("start.joint_pos = { fx = 1 }", ["start.joint_pos", "'fx'"]),
    ("start.noise.joint_pos = -1", ["start.noise.joint_pos", "0", "-1"]),
    ('root = "fl"', ["root", "'fl'", "trunk"]),
    ("timestep = -1", ["timestep", "-1"]),
    ('history_by = "tim"', ["history_by", "'term' or 'time'"]),
    ('parameters.k = { push = "trunc" }', ["parameters.k", "'trunc'", "did you mean 'trunk'"]),
    ('parameters.k = { push = "world" }', ["parameters.k", "'world'"]),
    ('parameters.k = { push = "trunk", at = "1 kg" }', ["parameters.k.at", "1 kg", "s"]),
    ('parameters.k = { push = "trunk", direction = [0, 0, 0] }', ["parameters.k", "direction"]),
    ('parameters.m = { field = "body/trunc/mass" }', ["box.xml", "'trunc'", "did you mean 'trunk'"]),
    ('parameters.m = { field = "bodi/trunk/mass" }', ["bodi/trunk/mass", "KIND/NAME/ATTRIBUTE"]),
    ('parameters.m = { field = "geom/fl/mas" }', ["box.xml", "geom/fl/mas", "did you mean 'mass'"]),
    ('parameters.m = { field = "body/trunk/mass" }', ["box.xml", "body/trunk/mass", "geom/NAME/mass"]),
    ('parameters.m = { field = "geom/fl/friction" }', ["geom/fl/friction", "3 numbers", "geom/fl/friction/0"]),
    ('parameters.m = { field = "geom/fl/mass", unit = "kilo" }', ["parameters.m.unit", "'kilo'", "unit"]),
    ('parameters.m = { field = "geom/fl/mass", range = [1] }', ["parameters.m.range", "more items"]),
    ('parameters.m = { field = "geom/fl/mass", range = [1, 2, 3] }', ["parameters.m.range", "at most 2 items"]),
    ("parameters.m = 3", ["parameters.m", "table", "3"]),
    ("action.stiffness.'f.' = 'a'", ["action.stiffness.'f.'", "number", "'a'"]),
    ("observation_clip = [1, -1]", ["observation_clip", "1", "-1"]),
    ("timestep = 1e-300", ["timestep", "1e-300"]),
    ('parameters.m = { field = "geom/fl/mass", range = [2, 1] }', ["parameters.m.range", "2", "1"]),
    ('parameters.m = { field = "geom/fl/mass", range = [5, 6] }', ["parameters.m", "[5.0, 6.0]", "0.2"]),
    ('parameters.m = { field = "geom/fl/mass", push = "trunk" }', ["parameters.m", "field", "push"]),
    ('parameters."a b" = { field = "geom/fl/mass" }', ["'a b'", "letters"]),
    ('command.lin_vel_x = "m"\nparameters.m = { field = "geom/fl/mass" }', ["two parameters", "'m'"]),
    ('failure.fell = "hieght < 0.1"', ["failure.fell", "`hieght`", "`height`"]),
    ('failure.fell = "height < 0.1 {rad}"', ["failure.fell", "m", "rad"]),
    ("failure.fell = 3", ["failure.fell", "text"]),
    ("action = {", ["robot.toml", "TOML", "line 6"]),
    ("duration = 3", ["robot.toml", "TOML", "line 6"]),
    ('deploy = "deploy.yaml"', ["deploy.yaml"]),
]  # fmt: skip


@pytest.mark.parametrize(("line", "facts"), KEYS)
def test_a_wrong_key_or_value(tmp_path, line, facts):
    assert states(refusal(tmp_path, f"{BASE}{line}\n"), *facts)


def test_a_control_period_that_no_file_states_or_that_is_no_whole_number_of_steps(tmp_path):
    no_period = BASE.replace("decimation = 4\n", "")
    assert states(refusal(tmp_path, no_period), "robot.toml", "`decimation`", "5 ms")
    (tmp_path / "deploy.yaml").write_text(
        "joint_ids_map: [0, 1, 2, 3]\nstep_dt: 0.02\nstiffness: [9, 9, 9, 9]\ndamping: [0.1, 0.1, 0.1, 0.1]\n"
        "default_joint_pos: [0, 0, 0, 0]\ncommands: {}\nactions: {JointPositionAction: {scale: [1, 1, 1, 1], "
        "offset: null, clip: null, joint_ids: null}}\nobservations: {joint_pos_rel: {params: {}}}\n"
    )
    toml = f'{no_period}deploy = "deploy.yaml"\n'
    assert states(refusal(tmp_path, f"{toml}timestep = 0.003\n"), "20 ms", "3 ms", "`timestep`")
    assert robot(tmp_path, toml, 4).rollout({}, 0).times[1] == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("name", "content", "facts"),
    [
        ("policy.h5", b"x", ["policy.h5", "ONNX"]),
        ("policy.onnx", b"x", ["policy.onnx", "ONNX"]),
        ("gone.onnx", None, ["gone.onnx", "no such file"]),
        ("control.py", b"", ["control.py", "control.py:NAME"]),
        ("gone.py:act", None, ["gone.py"]),
    ],
)
def test_a_policy_that_is_none(tmp_path, nothing_loaded, name, content, facts):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert states(refusal(tmp_path, f'policy = "{name}"\ndecimation = 4\n', None), *facts[:1])


def test_an_opset_that_the_installed_onnxruntime_does_not_know(tmp_path):
    (tmp_path / "box.xml").write_text(quadruped())
    save(tmp_path, "policy.onnx", linear(weights(4, 4), opset=99))
    with pytest.raises(UsageError, match=naming("policy.onnx", "opset 99", "onnxruntime", "opset_version")):
        opened(tmp_path, 'model = "box.xml"\npolicy = "policy.onnx"\n' + BASE)


def test_a_policy_that_returns_nan_is_at_fault_and_no_fall(tmp_path):
    (tmp_path / "box.xml").write_text(quadruped())
    save(tmp_path, "policy.onnx", linear(np.full((4, 4), np.nan)))
    backend = opened(tmp_path, 'model = "box.xml"\npolicy = "policy.onnx"\n' + BASE)
    with pytest.raises(BackendError, match=naming("not finite", "t = 0 s")):
        backend.rollout({}, 0)


HEAD = 'policy = "control.py:act"\ndecimation = 4\nduration = 0.2\n'
CONTROLLERS = [
    ("def act(model, data, command):\n    return 1 / 0\n", BackendError, ["control.py", "line 2", "ZeroDivisionError"]),
    ("def act(model, data, command):\n    return [1, 2]\n", BackendError, ["2", "4 actuators"]),
    ("def act(model, data, command):\n    return [float('nan')] * 4\n", BackendError, ["not finite", "t = 0 s"]),
    ("class act:\n    def __init__(self):\n        raise ValueError('no motor')\n", BackendError,
     ["control.py", "line 3", "no motor"]),
    ("def act(model, data, command:\n    return [0] * 4\n", UsageError, ["control.py:1"]),
    ("def acts(model, data, command):\n    return [0] * 4\n", UsageError, ["control.py", "'act'", "acts"]),
    ("import nosuch\n\n\ndef act(model, data, command):\n    return [0] * 4\n", UsageError, ["control.py", "'nosuch'"]),
]  # fmt: skip


@pytest.mark.parametrize(("code", "kind", "facts"), CONTROLLERS)
def test_a_controller_in_python_that_is_wrong(tmp_path, nothing_loaded, code, kind, facts):
    (tmp_path / "control.py").write_text(code)
    with pytest.raises(kind, match=naming(*facts)):
        robot(tmp_path, HEAD).rollout({}, 0)


def test_keys_without_an_effect_on_a_controller_in_python(tmp_path, nothing_loaded):
    (tmp_path / "control.py").write_text("def act(model, data, command):\n    return [0] * 4\n")
    for line, key in (("action.scale = 2", "action.scale"), ('observation = ["joint_pos"]', "observation")):
        assert states(refusal(tmp_path, f"{HEAD}{line}\n", None), key, "control.py:act")


def test_a_term_of_the_users_own_that_is_wrong(tmp_path, nothing_loaded):
    (tmp_path / "terms.py").write_text(
        "def two(model, data, command):\n    return 1, 2\n\n\n"
        "def late(model, data, command):\n    return [1 / (0.04 - data.time)] * 4\n"
    )
    with pytest.raises(UsageError, match=naming("policy.onnx", "4", "2")):
        robot(tmp_path, instead('"terms.py:two"'), 4).rollout({}, 0)
    with pytest.raises(BackendError, match=naming("terms.py", "line 6", "ZeroDivisionError")):
        robot(tmp_path, instead('"terms.py:late"'), 4).rollout({}, 0)
    assert states(refusal(tmp_path, instead('"terms.py:tow"'), 4), "terms.py", "'tow'", "two")


def test_nothing_of_the_user_runs_when_a_robot_is_opened_or_described(tmp_path, nothing_loaded):
    (tmp_path / "control.py").write_text(
        "from pathlib import Path\nPath(__file__).with_suffix('.ran').touch()\n\n\n"
        "def act(model, data, command):\n    return [0] * 4\n"
    )
    backend = robot(tmp_path, HEAD)
    assert backend.channels
    assert backend.parameters == ()
    assert re.fullmatch("[0-9a-f]{64}", backend.model_hash)
    assert any("control.py" in one.words for one in backend.preflight(run=False))
    assert not (tmp_path / "control.ran").exists()
    backend.rollout({}, 0)
    assert (tmp_path / "control.ran").exists()


def test_files_outside_of_the_folder_are_the_users_own(tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "models" / "box.xml").write_text(quadruped())
    save(tmp_path / "models", "policy.onnx", linear(weights(4, 4)))
    text = f'model = "../models/box.xml"\npolicy = "{tmp_path}/models/policy.onnx"\n{BASE}'
    assert len(opened(tmp_path / "mine", text).rollout({}, 0).times) == 6


@pytest.mark.parametrize("name", ["box.xml", "policy.onnx", "robot.toml"])
def test_the_hash_follows_every_file_and_a_file_that_is_gone_is_named(tmp_path, name):
    backend = robot(tmp_path, BASE, 4)
    first, path = backend.model_hash, tmp_path / name
    content = path.read_bytes()
    if name == "policy.onnx":
        save(tmp_path, name, linear(weights(4, 4, seed=1)))
    else:
        path.write_bytes(content.replace(b"0.1", b"0.11"))
    assert load_backend(backend.name).model_hash != first
    path.write_bytes(content)
    assert load_backend(backend.name).model_hash == first
    path.unlink()
    with pytest.raises(UsageError, match=naming(name)):
        load_backend(backend.name)


def test_the_hash_follows_what_the_model_includes_and_what_the_code_imports(tmp_path, nothing_loaded):
    """In a folder whose name looks like that of a robot file."""
    folder = tmp_path / "my.toml"
    (folder / "meshes").mkdir(parents=True)
    shell = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (folder / "meshes" / "shell.obj").write_text(shell)
    (folder / "parts.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset>'
        '<mesh name="m" file="shell.obj" scale="0.1 0.1 0.1"/></asset></mujoco>'
    )
    (folder / "gains.py").write_text("GAIN = 1\n")
    (folder / "control.py").write_text(
        "from gains import GAIN\n\n\ndef act(model, data, command):\n    return [GAIN] * 4\n"
    )
    model = quadruped().replace("<worldbody>", '<include file="parts.xml"/><worldbody>')
    backend = robot(folder, HEAD, None, model.replace("<site", '<geom type="mesh" mesh="m"/><site'))
    digests = {backend.model_hash}
    for name, old, new in (
        ("meshes/shell.obj", "v 1 0 0", "v 2 0 0"), ("parts.xml", "0.1 0.1 0.1", "0.1 0.1 0.2"), ("gains.py", "1", "2"),
    ):  # fmt: skip
        path = folder / name
        path.write_text(path.read_text().replace(old, new))
        digests.add(load_backend(backend.name).model_hash)
    assert len(digests) == 4
