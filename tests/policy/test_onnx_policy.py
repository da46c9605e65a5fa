"""ONNX policies: what runs, what is refused, and nothing outside of the model's folder."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from s2r_policy import open_policy
from s2r_spec.errors import UsageError
from tests.errors import naming

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"
OPSET = 17


def port(name, *shape, kind=TensorProto.FLOAT):
    return helper.make_tensor_value_info(name, kind, shape)


def model(nodes, inputs, outputs, weights=(), opset=OPSET, domains=()):
    graph = helper.make_graph(nodes, "policy", inputs, outputs, list(weights))
    imports = [helper.make_opsetid("", opset), *(helper.make_opsetid(name, 1) for name in domains)]
    return helper.make_model(graph, opset_imports=imports, ir_version=8)


WEIGHTS = np.arange(6, dtype=np.float32).reshape(3, 2)


def linear(shape=(1, 3), outputs=(1, 2), **rest):
    """Return a policy that multiplies an observation of three numbers with WEIGHTS."""
    weights = [numpy_helper.from_array(WEIGHTS, "w")]
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["actions"])]
    return model(nodes, [port("obs", *shape)], [port("actions", *outputs)], weights, **rest)


def newer(own):
    own.ir_version = 99
    return own


def recurrent(state_in="h_in", state_out="h_out"):
    """Return a policy whose action is the sum of all observations so far."""
    nodes = [
        helper.make_node("Add", ["obs", state_in], [state_out]),
        helper.make_node("Neg", [state_out], ["actions"]),
    ]
    return model(
        nodes, [port(state_in, 1, 3), port("obs", "batch", 3)], [port(state_out, 1, 3), port("actions", "batch", 3)]
    )  # fmt: skip


@pytest.fixture
def save(tmp_path):
    def write(content, name="policy.onnx"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.SerializeToString())
        return path

    return write


OBSERVATION = np.array([1.0, -2.0, 0.5], np.float32)


@pytest.mark.parametrize(
    ("shape", "outputs"), [((1, 3), (1, 2)), ((3,), (2,)), (("n", 3), ("n", 2)), (("n", "m"), ("n", "k"))]
)
def test_an_action_is_the_file_s_function_of_the_observation(save, shape, outputs):
    policy = open_policy(save(linear(shape, outputs)))
    assert policy.width == (3 if shape[-1] == 3 else None)
    action = policy(OBSERVATION)
    np.testing.assert_array_equal(action, OBSERVATION @ WEIGHTS)
    assert action.dtype == np.float32
    policy(2 * OBSERVATION)
    np.testing.assert_array_equal(action, OBSERVATION @ WEIGHTS)  # a new array at every call
    assert (policy.width, policy.outputs, policy.recurrent) == (3, 2, False)
    with pytest.raises(UsageError, match=naming("policy.onnx", "3", "4")):
        policy(np.zeros(4, np.float32))


@pytest.mark.parametrize(("state_in", "state_out"), [("h_in", "h_out"), ("memory", "remembered")])
def test_a_state_goes_on_and_begins_at_zero_again(save, state_in, state_out):
    policy = open_policy(save(recurrent(state_in, state_out)))
    assert policy.recurrent
    for _ in range(2):
        policy.reset()
        np.testing.assert_array_equal(policy(OBSERVATION), -OBSERVATION)
        np.testing.assert_array_equal(policy(OBSERVATION), -2 * OBSERVATION)
    assert any(state_in in note for note in policy.notes) == (state_in == "memory")


def test_metadata_digest_and_unused_outputs(save):
    own = linear()
    helper.set_model_props(own, {"joint_names": "hip,knee"})
    own.graph.node.append(helper.make_node("Neg", ["obs"], ["latent"]))
    own.graph.output.insert(0, port("latent", 1, 3))
    path = save(own)
    policy = open_policy(path)
    assert policy.metadata == {"joint_names": "hip,knee"}
    assert policy.files == (path,)
    assert policy.outputs == 2  # of the output that is named actions
    assert "latent" in " ".join(policy.notes)
    assert policy.digest == open_policy(path).digest
    assert policy.digest != open_policy(save(linear())).digest


def test_external_data_of_the_folder_belongs_to_the_policy(save, tmp_path):
    onnx.save(
        linear(), tmp_path / "policy.onnx", save_as_external_data=True, location="w.data", size_threshold=0
    )
    policy = open_policy(tmp_path / "policy.onnx")
    np.testing.assert_array_equal(policy(OBSERVATION), OBSERVATION @ WEIGHTS)
    assert [file.name for file in policy.files] == ["policy.onnx", "w.data"]
    (tmp_path / "w.data").write_bytes(bytes(24))
    assert open_policy(tmp_path / "policy.onnx").digest != policy.digest
    (tmp_path / "w.data").unlink()
    with pytest.raises(UsageError, match=naming("policy.onnx", "w.data")):
        open_policy(tmp_path / "policy.onnx")


@pytest.mark.parametrize("place", ["../secret", "absolute", "link", "inner/../../secret"])
def test_external_data_outside_of_the_folder_are_refused(tmp_path, place):
    secret = tmp_path / "secret"
    secret.write_bytes(WEIGHTS.tobytes())
    folder = tmp_path / "model"
    (folder / "inner").mkdir(parents=True)
    (folder / "link").symlink_to(secret)
    hostile = linear()
    tensor = hostile.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    location = str(secret) if place == "absolute" else place
    tensor.external_data.add(key="location", value=location)
    (folder / "policy.onnx").write_bytes(hostile.SerializeToString())
    with pytest.raises(UsageError, match=naming(str(folder / "policy.onnx"), location)):
        open_policy(folder / "policy.onnx")


def branch(operator, domain):
    """Return a policy with an operator in a branch, where no list of the graph's nodes has it."""
    bodies = {
        name: helper.make_graph(
            [helper.make_node(operator, ["obs"], ["a"], domain=domain)], name, [], [port("a", 1, 3)]
        )
        for name in ("then_branch", "else_branch")
    }  # fmt: skip
    nodes = [
        helper.make_node("ReduceMax", ["obs"], ["m"], keepdims=0),
        helper.make_node("Cast", ["m"], ["c"], to=TensorProto.BOOL),
        helper.make_node("If", ["c"], ["actions"], **bodies),
    ]
    return model(nodes, [port("obs", 1, 3)], [port("actions", 1, 3)], domains=[domain] if domain else [])


def test_a_custom_operator_is_refused_by_its_name(save):
    assert open_policy(save(branch("Neg", ""))).outputs == 3
    with pytest.raises(UsageError, match=naming("policy.onnx", "own.ops::Steal")):
        open_policy(save(branch("Steal", "own.ops")))


def test_a_function_that_the_file_defines_itself_runs(save):
    imports = [helper.make_opsetid("", OPSET)]
    body = [helper.make_node("Neg", ["x"], ["y"])]
    own = branch("Turn", "own.ops")
    own.functions.append(helper.make_function("own.ops", "Turn", ["x"], ["y"], body, imports))
    np.testing.assert_array_equal(open_policy(save(own))(OBSERVATION), -OBSERVATION)


@pytest.mark.parametrize(
    ("content", "facts"),
    [
        (b"", ()),
        (b"obs = [1, 2, 3]\n" * 20, ()),
        (linear().SerializeToString()[:-20], ()),
        (linear().SerializeToString()[:3], ()),
        (linear(opset=99), ("opset 99", "opset_version")),
        (newer(linear()), ("opset_version",)),
        (model([helper.make_node("Neg", ["obs"], ["actions"])], [port("obs", 1, 3, 8, 8)],
               [port("actions", 1, 3, 8, 8)]), ("obs", "(1, 3, 8, 8)")),
        (model([helper.make_node("ArgMax", ["obs"], ["choice"], axis=1)], [port("obs", 1, 3)],
               [port("choice", 1, 1, kind=TensorProto.INT64)]), ("choice", "tensor(int64)")),
        (model([helper.make_node("Mul", ["obs", "time_step"], ["actions"])],
               [port("obs", 1, 3), port("time_step", 1, 1)], [port("actions", 1, 3)]), ("time_step",)),
        (model([helper.make_node("Reshape", ["obs", "shape"], ["actions"])], [port("obs", 1, 3)],
               [port("actions", 1, 2)], [numpy_helper.from_array(np.array([1, 2]), "shape")]), ()),
    ],
    ids=["empty", "text", "cut", "beginning", "opset", "format", "image", "integers", "time_step", "fails"],
)  # fmt: skip
def test_a_file_that_is_no_policy_gets_one_sentence(save, content, facts):
    path = save(content)
    with pytest.raises(UsageError, match=naming(str(path), *facts)) as raised:
        open_policy(path)
    assert "\n" not in str(raised.value)


def test_a_missing_file_and_another_ending(tmp_path):
    with pytest.raises(UsageError, match=naming("none.onnx")):
        open_policy(tmp_path / "none.onnx")
    with pytest.raises(UsageError, match=naming(".onnx", "policy.pkl")):
        open_policy(tmp_path / "policy.pkl")


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="needs ../shared/robots")
@pytest.mark.parametrize(
    ("place", "width", "outputs"),
    [
        ("go1_playground/go1_policy.onnx", 48, 12),
        ("berkeley_humanoid_playground/bh_policy.onnx", 52, 12),
        ("g1_unitree_rl_lab/policy.onnx", 480, 29),
    ],
)
def test_public_policies_equal_a_plain_run(place, width, outputs):
    onnxruntime = pytest.importorskip("onnxruntime")
    policy = open_policy(ROBOTS / place)
    assert (policy.width, policy.outputs, policy.recurrent) == (width, outputs, False)
    plain = onnxruntime.InferenceSession(ROBOTS / place, providers=["CPUExecutionProvider"])
    for x in np.random.default_rng(1).normal(size=(5, width)).astype(np.float32):
        np.testing.assert_array_equal(policy(x), plain.run(None, {"obs": x[None]})[0][0])
