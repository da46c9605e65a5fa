"""deploy.yaml of Unitree: the public file beside its model, and small ones of each variant."""

from math import pi
from pathlib import Path

import pytest

from s2r_mujoco.deploy import read_deployment
from s2r_spec.errors import UsageError
from tests.errors import naming

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"
needs_robots = pytest.mark.skipif(not ROBOTS.exists(), reason="the public robots are not beside the checkout")

SMALL = """\
joint_ids_map: [2, 0, 1]
step_dt: 2e-2
stiffness: [10, 20, 30]
damping: [1, 2, 3]
default_joint_pos: [0.1, 0.2, 0.3]
commands: {base_velocity: {ranges: {lin_vel_x: [-0.5, 1.0], heading: null}}}
actions:
  JointPositionAction:
    clip: null
    joint_names: [.*]
    scale: [0.25, 0.5, 0.75]
    offset: [0.1, 0.2, 0.3]
    joint_ids: !!python/object/apply:builtins.slice [null, null, null]
observations:
  base_ang_vel: {params: {}, clip: [-10, 10], scale: [0.2, 0.2, 0.2], history_length: 5}
  gait_phase: {params: {period: 0.8}, clip: null, scale: [1.0, 1.0]}
  joint_pos_rel: {params: {asset_cfg: {joint_ids: [1, 2]}}, clip: null, scale: [1.0, 0.5]}
  task_obs: {params: {}, scale: [1.0, 1.0]}
  last_action: {params: {}, scale: null, history_length: 0}
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes the small file with some texts replaced, and returns its path."""

    def written(*changes: tuple[str, str]) -> Path:
        text = SMALL
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "deploy.yaml"
        path.write_text(text)
        return path

    return written


@needs_robots
def test_each_joint_of_the_public_g1_gets_its_own_pose_and_gains():
    mujoco = pytest.importorskip("mujoco")
    folder = ROBOTS / "g1_unitree_rl_lab"
    model = mujoco.MjModel.from_xml_path(str(folder / "g1_29dof.xml"))
    found = read_deployment(folder / "deploy.yaml")
    names = [model.actuator(actuator).name for actuator in found.actuators(model.nu)]
    pose = dict(zip(names, found.joint_pos, strict=True))
    gains = dict(zip(names, zip(found.stiffness, found.damping, strict=True), strict=True))
    for side in ("left", "right"):
        assert pose[f"{side}_hip_pitch_joint"] == -0.1
        assert pose[f"{side}_knee_joint"] == 0.3
        assert pose[f"{side}_elbow_joint"] == 0.97
        assert gains[f"{side}_knee_joint"] == (150.0, 4.0)
        assert gains[f"{side}_ankle_roll_joint"] == (40.0, 2.0)
    assert pose["left_shoulder_roll_joint"] == -pose["right_shoulder_roll_joint"] == 0.25
    assert gains["waist_yaw_joint"] == (200.0, 5.0)
    assert found.action_offset == found.joint_pos
    assert {term.history for term in found.terms} == {5}
    assert {term.name: term.scale for term in found.terms if term.scale} == {
        "base_ang_vel": (0.2,), "joint_vel_rel": (0.05,),
    }  # fmt: skip
    assert found.step == 0.02
    assert not found.unused


def test_gains_are_in_motor_order_and_all_else_in_policy_order(write):
    found = read_deployment(write())
    assert found.motors == (2, 0, 1)
    assert found.joint_pos == (0.1, 0.2, 0.3)
    assert found.stiffness == (30.0, 10.0, 20.0)
    assert found.damping == (3.0, 1.0, 2.0)
    assert found.action_scale == (0.25, 0.5, 0.75)
    assert found.step == 0.02
    assert found.command_ranges == {"lin_vel_x": (-0.5, 1.0)}


def test_terms_have_scale_clip_history_and_joints(write):
    path = write()
    speed, phase, joints, task, last = read_deployment(path).terms
    assert (speed.scale, speed.clip, speed.clip_first, speed.history) == ((0.2,), (-10.0, 10.0), True, 5)
    assert (joints.scale, joints.joints) == ((1.0, 0.5), (1, 2))
    assert task.name == "task_obs"  # no meaning here: the caller refuses it, or has a function for it
    assert (last.scale, last.history) == ((), 1)
    assert last.source == "deploy.yaml: observations.last_action"
    assert (phase.name, phase.parts, phase.frequency) == ("phase", ("sin", "cos"), 1.25)
    assert phase.start == pytest.approx(
        (2 * 2 * pi * 0.02 / 0.8,)
    )  # two steps: the controller's reset makes one


def test_one_group_scales_first_and_stacks_by_time(write):
    path = write(("observations:\n", "observations:\n  scale_first: true\n  use_gym_history: true\n"),
                 ("history_length: 5", "history_length: 1"))  # fmt: skip
    found = read_deployment(path)
    assert found.history_by == "time"
    assert not any(term.clip_first for term in found.terms)
    with pytest.raises(
        UsageError, match=naming("deploy.yaml", "observations.use_gym_history", "history_length")
    ):
        read_deployment(write(("observations:\n", "observations:\n  use_gym_history: true\n")))


def test_each_group_is_an_input_of_the_policy(write):
    head, _ = SMALL.split("observations:\n")
    path = write()
    path.write_text(
        f"{head}observations:\n"
        "  speed: {base_ang_vel: {params: {}, history_length: 2}}\n"
        "  rest: {use_gym_history: false, last_action: {params: {}}, joint_pos: {params: {}}}\n"
    )
    groups = [(term.group, term.name) for term in read_deployment(path).terms]
    assert groups == [("speed", "base_ang_vel"), ("rest", "last_action"), ("rest", "joint_pos")]


def test_motors_with_gaps_fit_a_model_of_all_motors_and_one_of_those_that_move(write):
    few = read_deployment(write(("[2, 0, 1]", "[7, 0, 3]")))
    assert few.stiffness == (30.0, 10.0, 20.0)  # of the moved motors 0, 3, 7
    assert few.actuators(3) == (2, 0, 1)
    assert few.actuators(9) == (7, 0, 3)
    with pytest.raises(ValueError, match=naming("3 joints", "motor 7", "5 actuators")):
        few.actuators(5)
    every = read_deployment(write(("[2, 0, 1]", "[4, 0, 1]"), ("[10, 20, 30]", "[10, 20, 30, 40, 50]"),
                                  ("[1, 2, 3]", "[1, 2, 3, 4, 5]")))  # fmt: skip
    assert every.stiffness == (50.0, 10.0, 20.0)


def test_several_actions_move_their_joints_in_the_order_of_the_file(write):
    velocity = (
        "  JointVelocityAction: {scale: [5.0], offset: null, clip: null, joint_ids: [0]}\nobservations:"
    )
    path = write(("scale: [0.25, 0.5, 0.75]", "scale: 0.25"), ("    offset: [0.1, 0.2, 0.3]\n", ""),
                 ("!!python/object/apply:builtins.slice [null, null, null]",
                  "!!python/object/apply:builtins.slice [1, null, null]"), ("observations:", velocity))  # fmt: skip
    found = read_deployment(path)
    assert found.action_joints == (1, 2, 0)
    assert found.action_scale == (0.25, 0.25, 5.0)
    assert found.action_offset == (0.2, 0.3, 0.0)
    assert found.velocity_joints == (0,)


def test_limits_of_the_actions_are_those_of_the_target(write):
    found = read_deployment(
        write(("    clip: null\n    joint_names", "    clip: [[-1, 1], [-2, 2], [-3, 3]]\n    joint_names"))
    )
    assert found.action_clip == ((-1.0, 1.0), (-2.0, 2.0), (-3.0, 3.0))
    assert not found.action_clip_first


def test_keys_without_a_meaning_are_listed(write):
    found = read_deployment(
        write(("step_dt: 2e-2", "step_dt: 2e-2\nversion: 3"), ("period: 0.8", "period: 0.8, offset: 1"))
    )
    assert found.unused == ("version", "observations.gait_phase.params.offset")


@pytest.mark.parametrize(
    ("old", "new", "facts"),
    [
        ("step_dt", "step_td", ["step_dt", "step_td"]),
        ("step_dt: 2e-2", "step_dt: fast", ["step_dt", "fast"]),
        ("step_dt: 2e-2", "step_dt: 0", ["step_dt", "above 0"]),
        ("[2, 0, 1]", "[2, 0, 0]", ["joint_ids_map", "twice"]),
        ("[2, 0, 1]", "[2, 0, -1]", ["joint_ids_map", "-1"]),
        ("[2, 0, 1]", "[]", ["joint_ids_map", "empty"]),
        ("[10, 20, 30]", "[10, 20]", ["stiffness", "2 numbers", "3"]),
        ("[10, 20, 30]", "[10, 20, -30]", ["stiffness", "below 0", "-30"]),
        ("default_joint_pos: [0.1, 0.2, 0.3]", "default_joint_pos: [0.1, 0.2]", ["default_joint_pos", "2", "3"]),
        ("default_joint_pos: [0.1, 0.2, 0.3]", "default_joint_pos: [0.1, 0.2, '0.3']", ["default_joint_pos"]),
        ("scale: [0.25, 0.5, 0.75]", "scale: [0.25]", ["actions.JointPositionAction.scale", "1", "3"]),
        ("JointPositionAction", "JointEffortAction", ["actions", "JointEffortAction", "JointPositionAction"]),
        ("[null, null, null]", "[x, null, null]", ["actions.JointPositionAction.joint_ids"]),
        ("!!python/object/apply:builtins.slice [null, null, null]", "[0, 3]", ["3", "2"]),
        ("scale: [0.2, 0.2, 0.2]", "scale: [0.2, 0.2]", ["observations.base_ang_vel.scale", "2", "3"]),
        ("clip: [-10, 10]", "clip: [10, -10]", ["observations.base_ang_vel.clip", "10", "-10"]),
        ("history_length: 5", "history_length: 5.5", ["observations.base_ang_vel.history_length", "5.5"]),
        ("history_length: 5", "history_length: 99999", ["observations.base_ang_vel.history_length", "99999"]),
        ("{period: 0.8}", "{}", ["observations.gait_phase.params", "period"]),
        ("lin_vel_x: [-0.5, 1.0]", "lin_vel_x: 1.0", ["commands.base_velocity.ranges.lin_vel_x"]),
        ("commands: {base_velocity: {", "commands: {base_velocity: 3}\nother: {x: {", ["commands.base_velocity"]),
    ],
)  # fmt: skip
def test_a_wrong_value_gets_one_sentence_with_file_and_key(write, old, new, facts):
    with pytest.raises(UsageError, match=naming("deploy.yaml", *facts)) as error:
        read_deployment(write((old, new)))
    assert "\n" not in str(error.value)
