"""Metadata of exporters of mjlab and whole_body_tracking, written into an ONNX file and read from it."""

import pytest

from s2r_mujoco.deploy import of_metadata
from s2r_spec.errors import UsageError
from tests.errors import naming

TWO = {
    "run_path": "team/run",
    "joint_names": "hip,knee",
    "joint_stiffness": "40.200,99.100",
    "joint_damping": "2.600,6.300",
    "default_joint_pos": "-0.100,0.300",
    "command_names": "twist",
    "observation_names": "base_lin_vel,projected_gravity,joint_pos,joint_vel,actions,command",
    "action_scale": "0.550,0.350",
}


def test_an_onnx_file_says_what_its_exporter_wrote(tmp_path):
    onnx = pytest.importorskip("onnx")
    value = onnx.helper.make_tensor_value_info("obs", onnx.TensorProto.FLOAT, [1, 1])
    other = onnx.helper.make_tensor_value_info("actions", onnx.TensorProto.FLOAT, [1, 1])
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Identity", ["obs"], ["actions"])], "g", [value], [other]
    )
    model = onnx.helper.make_model(graph)
    onnx.helper.set_model_props(model, TWO)
    onnx.save(model, tmp_path / "policy.onnx")
    read = onnx.load(tmp_path / "policy.onnx").metadata_props
    found = of_metadata({entry.key: entry.value for entry in read}, "policy.onnx")
    assert found is not None
    assert found.joints == ("hip", "knee")
    assert (found.stiffness, found.damping) == ((40.2, 99.1), (2.6, 6.3))
    assert found.joint_pos == found.action_offset == (-0.1, 0.3)
    assert found.action_scale == (0.55, 0.35)
    assert [term.name for term in found.terms] == [
        "base_lin_vel", "projected_gravity", "joint_pos_rel", "joint_vel_rel", "last_action", "velocity_commands",
    ]  # fmt: skip
    assert found.unused == ("run_path",)


def test_one_action_scale_is_that_of_all_joints():
    assert of_metadata({**TWO, "action_scale": "0.5"}, "p").action_scale == (0.5, 0.5)


def test_a_motion_to_track_is_no_velocity():
    found = of_metadata({**TWO, "command_names": "motion"}, "p")
    assert found.terms[-1].name == "command"


@pytest.mark.parametrize(
    "lengths", ["5.000,1.000,5.000,5.000,5.000,1.000", '{"base_lin_vel": 5, "joint_pos": 5}']
)
def test_histories_are_read_from_a_list_or_by_name(lengths):
    found = of_metadata({**TWO, "observation_history_lengths": lengths}, "p")
    assert [term.history for term in found.terms[:3]] == [5, 1, 5]


def test_lists_may_be_json():
    found = of_metadata({**TWO, "joint_names": '["hip", "knee"]', "default_joint_pos": "[-0.1, 0.3]"}, "p")
    assert (found.joints, found.joint_pos) == (("hip", "knee"), (-0.1, 0.3))


@pytest.mark.parametrize("metadata", [{}, {"author": "x"}, {"joint_names": "hip"}])
def test_other_metadata_is_no_deployment(metadata):
    assert of_metadata(metadata, "policy.onnx") is None


@pytest.mark.parametrize(
    ("key", "value", "facts"),
    [
        ("joint_stiffness", "40.2", ["1", "2"]),
        ("joint_damping", "-1,2", ["below 0", "-1"]),
        ("default_joint_pos", "a,b", ["numbers", "a"]),
        ("default_joint_pos", "nan,0.3", ["numbers", "nan"]),
        ("default_joint_pos", "[1e999, 0.3]", ["numbers"]),
        ("default_joint_pos", "[NaN, 0.3]", ["numbers"]),
        ("default_joint_pos", "[" * 100_000, ["JSON"]),
        ("default_joint_pos", "0," * 200_000, ["letters"]),
        ("joint_names", "hip,hip", ["hip", "twice"]),
        ("observation_names", '["a", 3]', ["names"]),
        ("observation_history_lengths", "1,2", ["6"]),
        ("observation_history_lengths", "1,1,1,1,1,1e9", ["1000"]),
        ("action_scale", "0.5,0.5,0.5", ["3", "2"]),
    ],
)
def test_a_wrong_value_gets_one_sentence_with_file_and_key(key, value, facts):
    with pytest.raises(UsageError, match=naming("policy.onnx", key, *facts)) as error:
        of_metadata({**TWO, key: value}, "policy.onnx")
    assert len(str(error.value)) < 400
