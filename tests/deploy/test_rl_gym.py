"""The yaml files of unitree_rl_gym, for MuJoCo and for the real robot."""

from math import pi
from pathlib import Path

import pytest

from s2r_mujoco.deploy import read_deployment
from s2r_spec.errors import UsageError
from tests.errors import naming

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"
needs_robots = pytest.mark.skipif(not ROBOTS.exists(), reason="the public robots are not beside the checkout")

SMALL = """\
policy_path: "{LEGGED_GYM_ROOT_DIR}/policy.pt"
xml_path: scene.xml
simulation_dt: 0.004
control_decimation: 5
kps: [100, 50]
kds: [2, 1]
default_angles: [-0.1, 0.3]
ang_vel_scale: 0.25
dof_pos_scale: 1.0
dof_vel_scale: 0.05
action_scale: 0.25
cmd_scale: [2.0, 2.0, 0.25]
num_actions: 2
num_obs: 17
cmd_init: [0.5, 0, 0]
"""


@needs_robots
def test_the_public_g1_is_read():
    found = read_deployment(ROBOTS / "g1_unitree_rl_gym" / "g1.yaml")
    assert (found.stiffness[3], found.damping[3], found.joint_pos[3]) == (150.0, 4.0, 0.3)
    assert (found.timestep, found.step) == (0.002, pytest.approx(0.02))
    assert found.action_scale == (0.25,) * 12
    assert found.unused == ("simulation_duration", "cmd_init")


def test_the_observation_is_the_fixed_one_of_its_script(tmp_path):
    path = tmp_path / "toy.yaml"
    path.write_text(SMALL)
    found = read_deployment(path)
    assert [(term.name, term.scale) for term in found.terms] == [
        ("base_ang_vel", (0.25,)), ("projected_gravity", ()), ("velocity_commands", (2.0, 2.0, 0.25)),
        ("joint_pos_rel", ()), ("joint_vel", (0.05,)), ("last_action", ()), ("phase", ()),
    ]  # fmt: skip
    assert found.terms[-1].start == pytest.approx((2 * pi * 0.02 / 0.8,))
    assert (found.policy, found.model) == ("{LEGGED_GYM_ROOT_DIR}/policy.pt", "scene.xml")
    assert found.actuators(2) == (0, 1)


def test_a_file_for_the_real_robot_has_motors_and_the_largest_command(tmp_path):
    path = tmp_path / "toy.yaml"
    text = SMALL.replace(
        "simulation_dt: 0.004\ncontrol_decimation: 5", "control_dt: 0.02\nmax_cmd: [0.8, 0.5, 1.57]"
    )
    path.write_text(f"{text}leg_joint2motor_idx: [7, 3]\n")
    found = read_deployment(path)
    assert (found.motors, found.step, found.timestep) == ((7, 3), 0.02, None)
    assert found.command_ranges["ang_vel_z"] == (-1.57, 1.57)


@pytest.mark.parametrize(
    ("old", "new", "facts"),
    [
        ("kps: [100, 50]", "kps: [100]", ["kps", "1", "2"]),
        ("kds: [2, 1]", "kds: none", ["kds", "none"]),
        ("num_obs: 17", "num_obs: 48", ["num_obs", "48", "17"]),
        ("num_actions: 2", "num_actions: 2.5", ["num_actions", "2.5"]),
        ("control_decimation: 5", "control_decimation: 0", ["control_decimation", "1", "0"]),
        ("ang_vel_scale: 0.25", "ang_velocity_scale: 0.25", ["ang_vel_scale", "ang_velocity_scale"]),
        ("cmd_scale: [2.0, 2.0, 0.25]", "cmd_scale: [2.0]", ["cmd_scale", "1", "3"]),
    ],
)
def test_a_wrong_value_gets_one_sentence_with_file_and_key(tmp_path, old, new, facts):
    assert old in SMALL
    path = tmp_path / "toy.yaml"
    path.write_text(SMALL.replace(old, new))
    with pytest.raises(UsageError, match=naming("toy.yaml", *facts)):
        read_deployment(path)
