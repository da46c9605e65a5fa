"""base.yaml and config.yaml of rl_sar: the public B2, and small ones of each version."""

from math import pi
from pathlib import Path

import pytest

from s2r_mujoco.deploy import read_deployment
from s2r_spec.errors import UsageError
from tests.errors import naming

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"
needs_robots = pytest.mark.skipif(not ROBOTS.exists(), reason="the public robots are not beside the checkout")

BASE = """\
toy:
  dt: 0.005
  decimation: 4
  num_of_dofs: 3
  torque_limits: [7, 8, 9]
  default_dof_pos: [0, 0, 0]
  fixed_kp: [1, 1, 1]
  joint_names: [hip, knee, wheel]
  joint_mapping: [0, 1, 2]
"""
POLICY = """\
toy/walk:
  model_name: "policy.pt"
  num_observations: 18
  observations: ["ang_vel", "gravity_vec", "commands", "dof_pos", "dof_vel", "actions"]
  observations_history: [2, 1, 0]
  observations_history_priority: "term"
  clip_obs: 50.0
  clip_actions_lower: [-1, -2, -3]
  clip_actions_upper: [1, 2, 3]
  rl_kp: [20, 30, 0]
  rl_kd: [1, 2, 3]
  num_of_dofs: 3
  action_scale: [0.5, 0.25, 5.0]
  wheel_indices: [2]
  ang_vel_scale: 0.25
  dof_pos_scale: 1.0
  dof_vel_scale: 0.05
  commands_scale: [2.0, 2.0, 0.25]
  default_dof_pos: [0.1, 0.8, 0.0]
  joint_mapping: [1, 0, 2]
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes both files as rl_sar has them, and returns the policy's path."""

    def written(policy: str = POLICY, base: str = BASE, folder: str = "toy/walk") -> Path:
        path = tmp_path / folder / "config.yaml"
        path.parent.mkdir(parents=True)
        path.write_text(policy)
        if base:
            (tmp_path / "toy" / "base.yaml").write_text(base)
        return path

    return written


@needs_robots
def test_the_public_b2_is_read():
    found = read_deployment(ROBOTS / "b2_rl_sar" / "config.yaml")
    assert found.joints[:3] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint")
    assert found.joint_pos[:3] == (0.0, 0.8, -1.5)
    assert (found.stiffness[2], found.damping[2], found.torque_limit[2]) == (160.0, 5.0, 320.0)
    assert found.step == pytest.approx(0.02)
    assert found.timestep is None
    assert [(term.name, term.scale) for term in found.terms] == [
        ("base_ang_vel", (0.25,)), ("projected_gravity", ()), ("velocity_commands", ()),
        ("joint_pos_rel", ()), ("joint_vel", (0.05,)), ("last_action", ()),
    ]  # fmt: skip
    assert found.observation_clip == (-100.0, 100.0)
    assert [path.name for path in found.files] == ["config.yaml", "base.yaml"]
    with pytest.raises(UsageError, match=naming("base.yaml", "observations", "config.yaml")):
        read_deployment(ROBOTS / "b2_rl_sar" / "base.yaml")


def test_the_policy_replaces_the_robot_and_names_follow_the_motors(write):
    found = read_deployment(write())
    assert found.motors == (1, 0, 2)
    assert found.joints == ("knee", "hip", "wheel")
    assert found.joint_pos == found.action_offset == (0.1, 0.8, 0.0)
    assert found.torque_limit == (7.0, 8.0, 9.0)  # of the robot
    assert found.policy == "policy.pt"
    assert found.unused == ("toy/walk.num_observations", "toy.fixed_kp")


def test_wheels_have_a_velocity_and_no_angle(write):
    found = read_deployment(write())
    assert found.velocity_joints == (2,)
    assert found.terms[3].scale == (1.0, 1.0, 0.0)


def test_histories_keep_their_order_and_begin_with_zeros(write, tmp_path):
    found = read_deployment(write())
    assert {(term.history, term.newest_first) for term in found.terms} == {(3, False)}
    assert (found.history_by, found.history_start) == ("term", "zero")
    path = tmp_path / "toy" / "walk" / "config.yaml"
    path.write_text(
        POLICY.replace("[2, 1, 0]", "[0, 1, 2]").replace('  observations_history_priority: "term"\n', "")
    )
    found = read_deployment(path)
    assert {(term.history, term.newest_first) for term in found.terms} == {(3, True)}
    assert found.history_by == "time"
    path.write_text(POLICY.replace("[2, 1, 0]", "[]"))
    assert {term.history for term in read_deployment(path).terms} == {1}


def test_actions_are_limited_before_they_are_scaled(write):
    found = read_deployment(write())
    assert found.action_clip == ((-1.0, 1.0), (-2.0, 2.0), (-3.0, 3.0))
    assert found.action_clip_first
    assert found.action_scale == (0.5, 0.25, 5.0)


def test_the_robot_is_as_many_folders_above_as_the_key_has_slashes(write):
    found = read_deployment(write(POLICY.replace("toy/walk:", "toy/mimic/walk:"), folder="toy/mimic/walk"))
    assert found.step == pytest.approx(0.02)


def test_without_the_robots_file_the_policys_own_keys_remain(write):
    found = read_deployment(write(base=""))
    assert (found.step, found.joints, found.motors) == (None, (), (1, 0, 2))


def test_phases_become_terms_with_their_frequencies(write):
    found = read_deployment(write(POLICY.replace('"ang_vel"', '"g1_phase", "phase", "mimic_phase"')))
    gait, *slow, unknown = found.terms[:5]
    assert (gait.frequency, gait.parts) == (1.25, ("sin", "cos"))
    assert gait.start == pytest.approx((2 * pi * 0.02 / 0.8,))
    assert [term.frequency for term in slow] == [0.25, 0.125, 0.0625]
    assert unknown.name == "mimic_phase"


def test_files_of_2024_are_read(tmp_path):
    path = tmp_path / "config.yaml"
    text = POLICY.replace(
        "joint_mapping: [1, 0, 2]", "state_mapping: [1, 2, 0]\n  command_mapping: [2, 0, 1]"
    )
    text = text.replace("[0.5, 0.25, 5.0]", "0.5\n  action_scale_wheel: 4.0\n  hip_scale_reduction: 0.5\n"
                        "  hip_scale_reduction_indices: [0]")  # fmt: skip
    text = text.replace(
        "  observations_history: [2, 1, 0]\n", "  use_history: True\n  dt: 0.01\n  decimation: 2\n"
    )
    path.write_text(text)
    found = read_deployment(path)
    assert found.motors == (1, 2, 0)
    assert found.action_scale == (0.25, 0.5, 4.0)
    assert found.terms[-1].scale == (
        0.5,
        1.0,
        1.0,
    )  # the reduced action is the one that the policy sees again
    assert {(term.history, term.newest_first) for term in found.terms} == {(6, False)}
    assert (found.step, found.history_by) == (pytest.approx(0.02), "time")


def test_one_of_several_policies_is_chosen_by_its_key(write):
    path = write(POLICY + POLICY.replace("toy/walk", "toy/run").replace("[20, 30, 0]", "[50, 60, 0]"))
    with pytest.raises(UsageError, match=naming("toy/run", "toy/walk", "config.yaml#")):
        read_deployment(path)
    assert read_deployment(Path(f"{path}#toy/run")).stiffness == (50.0, 60.0, 0.0)
    with pytest.raises(UsageError, match=naming("toy/fly", "toy/run", "toy/walk")):
        read_deployment(Path(f"{path}#toy/fly"))


@pytest.mark.parametrize(
    ("old", "new", "facts"),
    [
        ("rl_kp: [20, 30, 0]", "rl_kp: [20, 30]", ["toy/walk.rl_kp", "2", "3"]),
        ("ang_vel_scale: 0.25", "other: 0.25", ["ang_vel_scale"]),
        ("clip_obs: 50.0", "clip_obs: 0", ["toy/walk.clip_obs", "above 0"]),
        ("num_of_dofs: 3", "num_of_dofs: 1e12", ["toy/walk.num_of_dofs", "1000"]),
        ("[2, 1, 0]", "[2, 0]", ["toy/walk.observations_history", "[2, 0]"]),
        ('"term"', '"age"', ["toy/walk.observations_history_priority", "age"]),
        ("wheel_indices: [2]", "wheel_indices: [3]", ["toy/walk.wheel_indices", "3"]),
        ("commands_scale: [2.0, 2.0, 0.25]", "commands_scale: [2.0]", ["toy/walk.commands_scale", "1", "3"]),
        ("clip_actions_lower: [-1, -2, -3]", "clip_actions_lower: [2, -2, -3]", ["clip_actions_upper", "joint 0"]),
        ("joint_mapping: [1, 0, 2]", "joint_mapping: [1, 0, 5]", ["toy.joint_names", "3", "5"]),
        ("joint_mapping: [1, 0, 2]", "joint_mapping: [1, 0]", ["toy/walk.joint_mapping", "2", "3"]),
        ("toy/walk:", "other/walk:", ["other", "toy"]),
        ('"ang_vel", ', '"ang_vel", "ang_vel", ', ["toy/walk.observations", "ang_vel", "twice"]),
        ('"ang_vel", ', "3, ", ["toy/walk.observations"]),
        ("  clip_obs", "  framework: isaacsim\n  rows: 1\n  clip_obs", ["toy/walk.rows"]),
    ],
)  # fmt: skip
def test_a_wrong_value_gets_one_sentence_with_file_and_key(write, old, new, facts):
    assert old in POLICY
    with pytest.raises(UsageError, match=naming(".yaml", *facts)) as error:
        read_deployment(write(POLICY.replace(old, new)))
    assert "\n" not in str(error.value)
