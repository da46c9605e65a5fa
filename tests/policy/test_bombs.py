"""Small files that would take all time or memory are refused."""

import zipfile

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from s2r_gym.sb3 import read_actor
from s2r_policy import onnx_policy, open_policy
from s2r_spec.errors import UsageError


def save(path, nodes, width, weights=()):
    ports = [[helper.make_tensor_value_info(one, TensorProto.FLOAT, [1, width])] for one in ("obs", "action")]
    graph = helper.make_graph(nodes, "policy", *ports, [numpy_helper.from_array(v, n) for n, v in weights])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, path)
    return path


def test_a_loop_without_end_is_stopped(tmp_path, monkeypatch):
    value = helper.make_tensor_value_info
    inputs = [
        value("i", TensorProto.INT64, []),
        value("c", TensorProto.BOOL, []),
        value("x", TensorProto.FLOAT, [1, 3]),
    ]
    outputs = [value("d", TensorProto.BOOL, []), value("y", TensorProto.FLOAT, [1, 3])]
    nodes = [helper.make_node("Identity", ["c"], ["d"]), helper.make_node("Add", ["x", "x"], ["y"])]
    body = helper.make_graph(nodes, "body", inputs, outputs)
    loop = helper.make_node("Loop", ["count", "go", "obs"], ["action"], body=body)
    weights = [("count", np.array(2**62)), ("go", np.array(True))]
    monkeypatch.setattr(onnx_policy, "LONGEST", 0.1)
    with pytest.raises(UsageError, match="cannot evaluate"):
        open_policy(save(tmp_path / "p.onnx", [loop], 3, weights))


def test_an_observation_of_terabytes_is_refused(tmp_path):
    path = save(tmp_path / "p.onnx", [helper.make_node("Identity", ["obs"], ["action"])], 2**40)
    with pytest.raises(UsageError, match="obs"):
        open_policy(path)


@pytest.mark.parametrize(("name", "member"), [("p.pt", "p/data/0"), ("p.zip", "policy.pth")])
def test_an_archive_that_expands_a_thousandfold_is_not_read(tmp_path, name, member):
    with zipfile.ZipFile(tmp_path / name, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("p/data.pkl", b"")
        archive.writestr("p/constants.pkl", b"")
        archive.writestr(member, bytes(10_000_000))
    with pytest.raises(UsageError, match="expands"):
        (read_actor if name.endswith("zip") else open_policy)(tmp_path / name)
