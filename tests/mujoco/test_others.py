"""What robots of other authors bring along: no actuators, other floors, several free bodies, files that are missing."""

import numpy as np
import pytest

from s2r_spec import diagnose, parse_spec
from s2r_spec.backend import load_backend
from s2r_spec.errors import BackendError, UsageError
from tests.errors import naming
from tests.mujoco.make_policies import linear
from tests.mujoco.robots import LEGS, opened, quadruped, robot, save, weights

PD = 'observation = ["joint_pos_rel"]\naction = { stiffness = 30, damping = 0.8 }\ndecimation = 4\nduration = 0.2\n'
STILL = "import numpy as np\n\n\ndef act(model, data, command):\n    return np.zeros(model.nu)\n"
CONTROLLED = 'policy = "still.py:act"\ndecimation = 4\nduration = 0.2\n'
FLOOR = '<geom name="floor" type="plane" size="0 0 0.1"/>'
MESH = '<geom type="mesh" mesh="shell" {}/>'


def controlled(folder, model, text=""):
    """Return a robot with a controller in Python."""
    (folder / "still.py").write_text(STILL)
    return robot(folder, CONTROLLED + text, None, model)


def without_motors():
    return quadruped().replace("<actuator>", "<!--").replace("</actuator>", "-->")


def test_motors_of_the_robot_file_equal_those_of_the_model(tmp_path):
    folders = [tmp_path / "own", tmp_path / "added"]
    for folder in folders:
        folder.mkdir()
    own = robot(folders[0], PD, 4).rollout({}, 0)
    added = robot(folders[1], f"motors = true\n{PD}", 4, without_motors()).rollout({}, 0)
    assert np.array_equal(own["q"], added["q"])
    assert np.array_equal(own["tau"], added["tau"])


def test_motors_are_refused_beside_actuators_and_named_without_any(tmp_path):
    with pytest.raises(UsageError, match=naming("motors")):
        robot(tmp_path, PD, 4, without_motors())
    with pytest.raises(UsageError, match=naming("motors")):
        robot(tmp_path, f"motors = true\n{PD}", 4)


@pytest.mark.parametrize(
    "floor",
    [
        '<geom type="box" size="5 5 0.2" pos="0 0 -0.2"/>',
        '<geom type="hfield" hfield="flat"/>',
    ],
)
def test_a_robot_stands_on_a_floor_of_another_shape_as_on_a_plane(tmp_path, floor):
    level = f'<hfield name="flat" nrow="3" ncol="3" size="5 5 0.1 0.1" elevation="{"0 " * 9}"/>'
    model = quadruped().replace("<worldbody>", f"<asset>{level}</asset><worldbody>")
    folders = [tmp_path / "plane", tmp_path / "other"]
    heights = []
    for folder, xml in zip(folders, (model, model.replace(FLOOR, floor)), strict=True):
        folder.mkdir()
        trace = robot(folder, PD, 4, xml).rollout({}, 0)
        heights.append(trace["height"])
    assert heights[0][0] == pytest.approx(0.22, abs=1e-3)  # legs of 0.2 m with a radius of 0.02 m
    assert heights[1] == pytest.approx(heights[0], abs=2e-3)


def test_the_root_is_the_free_body_that_has_the_motors(tmp_path):
    ball = '<body name="ball" pos="1 0 1"><freejoint/><geom type="sphere" size="0.1"/></body>'
    trace = controlled(
        tmp_path, quadruped().replace('<body name="trunk"', f'{ball}<body name="trunk"')
    ).rollout({}, 0)
    assert trace["x"][0] == 0.0


def test_an_arm_on_the_ground_has_no_root_although_a_free_body_lies_beside_it(tmp_path):
    model = """<mujoco><worldbody>
      <body pos="0 0 1"><joint name="elbow" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body>
      <body pos="1 0 1"><freejoint/><geom size="0.1"/></body>
    </worldbody><actuator><motor joint="elbow"/></actuator></mujoco>"""
    names = [one.name for one in controlled(tmp_path, model).channels]
    assert "q" in names
    assert not {"vx", "height"} & {*names}


def test_actuators_of_sites_and_tendons_alone_take_a_controller_but_no_policy(tmp_path):
    model = """<mujoco><worldbody><geom type="plane" size="1 1 0.1"/>
      <body name="drone" pos="0 0 1"><freejoint/><geom size="0.1"/><site name="rotor"/></body>
    </worldbody><actuator><motor site="rotor" gear="0 0 1 0 0 0"/></actuator></mujoco>"""
    assert controlled(tmp_path, model, "start.height = 1.0\n").rollout({}, 0)["vz"][-1] < 0
    with pytest.raises(UsageError, match=naming("policy.onnx")):
        robot(tmp_path, 'decimation = 4\nobservation = ["base_ang_vel"]\n', 3, model, outputs=1)


def test_a_position_target_with_a_filter_begins_at_the_start_pose(tmp_path):
    """The filter would pull the joints to 0 otherwise; the same holds of an actuator that the policy does not move."""
    lagging = '<position name="{leg}" joint="{leg}" kp="500" kv="20" timeconst="0.5"/>'
    toml = (
        'observation = ["joint_pos_rel"]\ndecimation = 4\nduration = 0.1\naction.joints = ["fl", "fr"]\n'
        "default_joint_pos = 0.5\nstart = { height = 2.0, joint_pos = { '.*' = 0.5 } }\n".replace(
            "'.*'", "fl"
        )
    )
    toml = toml.replace("{ fl = 0.5 }", "{ fl = 0.5, fr = 0.5, rl = 0.4, rr = 0.4 }")
    save(tmp_path, "still.onnx", linear(np.zeros((2, 2))))
    (tmp_path / "box.xml").write_text(quadruped(actuator=lagging))
    trace = opened(tmp_path, f'model = "box.xml"\npolicy = "still.onnx"\n{toml}').rollout({}, 0)
    assert trace["q"][-1] == pytest.approx(np.array([0.5, 0.5, 0.4, 0.4]), abs=5e-3)


@pytest.mark.parametrize(
    ("where", "attributes", "needed"),
    [
        ("trunk", 'contype="0" conaffinity="0" mass="0"', False),
        ("trunk", 'contype="0" conaffinity="0"', True),
        ("trunk", 'mass="0"', True),
        ("world", 'contype="0" conaffinity="0"', False),
    ],
)
def test_a_mesh_file_may_be_missing_if_nothing_depends_on_it(tmp_path, where, attributes, needed):
    geom = MESH.format(attributes)
    place = '<freejoint name="root"/>' if where == "trunk" else FLOOR
    model = quadruped().replace(place, place + geom)
    model = model.replace("<worldbody>", '<asset><mesh name="shell" file="shell.stl"/></asset><worldbody>')
    if needed:
        with pytest.raises(UsageError, match=naming("shell.stl")):
            controlled(tmp_path, model)
    else:
        assert len(controlled(tmp_path, model).rollout({}, 0)) > 1


GYM = """\
policy_path: "{LEGGED_GYM_ROOT_DIR}/trained/policy.onnx"
xml_path: "{LEGGED_GYM_ROOT_DIR}/box.xml"
simulation_dt: 0.005
control_decimation: 4
kps: [30, 30, 30, 30]
kds: [1, 1, 1, 1]
default_angles: [0, 0, 0, 0]
ang_vel_scale: 0.25
dof_pos_scale: 1.0
dof_vel_scale: 0.05
action_scale: 0.25
cmd_scale: [2.0, 2.0, 0.25]
num_actions: 4
num_obs: 23
"""


def deployed(folder, text=GYM, outputs=4):
    """Write a repository: its model and its policy at the root, its deploy file two folders below."""
    (folder / "trained").mkdir()
    save(folder / "trained", "policy.onnx", linear(weights(outputs, 11 + 3 * outputs)))
    (folder / "box.xml").write_text(quadruped())
    (folder / "deploy" / "configs").mkdir(parents=True)
    (folder / "deploy" / "configs" / "box.yaml").write_text(text)
    return opened(folder, 'deploy = "deploy/configs/box.yaml"\nduration = 0.1\n')


def test_a_deploy_file_names_its_policy_and_its_model(tmp_path):
    assert len(deployed(tmp_path).rollout({}, 0)) == 6


def test_a_policy_that_the_deploy_file_names_and_that_is_missing_is_named_with_the_file(tmp_path):
    with pytest.raises(UsageError, match=naming("policy", "box.yaml", "other.onnx")):
        deployed(tmp_path, GYM.replace("trained/policy.onnx", "other.onnx"))


def test_motors_of_the_real_robot_do_not_reorder_a_model_of_the_policys_joints_alone(tmp_path):
    text = GYM.replace("simulation_dt: 0.005\ncontrol_decimation: 4", "control_dt: 0.02")
    backend = deployed(tmp_path, text + "leg_joint2motor_idx: [7, 3, 8, 0]\n")
    table = next(one for one in backend.preflight(run=False) if one.topic == "joints").table
    assert [line.split()[1] for line in table[1:]] == [*LEGS]


@pytest.mark.parametrize(
    ("code", "error", "names"),
    [
        ("def act(model, data):\n    return 0\n", UsageError, ("still.py:act",)),
        ("def act(model, data, command):\n    return 'go'\n", BackendError, ("'go'", "4")),
        ("def act(model, data, command):\n    return None\n", BackendError, ("None", "4")),
    ],
)
def test_a_controller_of_another_form_is_named(tmp_path, code, error, names):
    backend = controlled(tmp_path, quadruped())
    (tmp_path / "still.py").write_text(code)
    with pytest.raises(error, match=naming(*names)):
        load_backend(backend.name).rollout({}, 0)


@pytest.mark.parametrize(
    ("code", "names"),
    [
        ("def term(model, data, command):\n    return [float('nan')] * 4\n", ("still.py:term",)),
        ("def term(model, data, command):\n    return [0.0] * 3\n", ("policy.onnx", "still.py:term 3")),
    ],
)
def test_a_term_of_the_users_own_that_does_not_fit_is_named(tmp_path, code, names):
    (tmp_path / "still.py").write_text(code)
    backend = robot(tmp_path, PD.replace('["joint_pos_rel"]', '["still.py:term"]'), 4)
    with pytest.raises((UsageError, BackendError), match=naming(*names)):
        backend.rollout({}, 0)


@pytest.mark.parametrize(
    ("toml", "names"),
    [
        ('action.scale = "half"\n', ("robot.toml", "action.scale", "half")),
        ('failure.fell = "abs(rol) > 1"\n', ("robot.toml", "failure.fell", "rol", "roll")),
        ('observation = ["joint_pos_re"]\n', ("robot.toml", "observation", "joint_pos_re", "joint_pos_rel")),
    ],
)
def test_a_wrong_key_of_the_robot_file_is_named(tmp_path, toml, names):
    key = toml.partition(" ")[0]
    head = "".join(line for line in PD.splitlines(True) if not line.startswith(key.partition(".")[0]))
    with pytest.raises(UsageError, match=naming(*names)):
        robot(tmp_path, toml + head, 4).prepare()


def test_joints_in_the_robot_file_that_are_fewer_than_in_the_deploy_file_are_counted(tmp_path):
    deployed(tmp_path)
    with pytest.raises(UsageError, match=naming("robot.toml", "action.joints", "3", "4", "box.yaml")):
        opened(tmp_path, 'deploy = "deploy/configs/box.yaml"\naction.joints = ["fl", "fr", "rl"]\n')


def levels(backend):
    return {one.topic: (one.level, one.words) for one in backend.preflight(run=True)}


def test_the_preflight_tells_a_robot_that_does_not_move_and_motors_left_alone(tmp_path):
    toml = PD.replace("duration = 0.2", 'command.lin_vel_x = "vd"') + 'action.joints = ["fl", "fr"]\n'
    toml = toml.replace(
        "action = { stiffness = 30, damping = 0.8 }\n", "action.stiffness = 30\naction.damping = 0.8\n"
    )
    save(tmp_path, "still.onnx", linear(np.zeros((2, 5))))
    (tmp_path / "box.xml").write_text(quadruped())
    toml = toml.replace('["joint_pos_rel"]', '["joint_pos_rel", "velocity_commands"]')
    found = levels(opened(tmp_path, f'model = "box.xml"\npolicy = "still.onnx"\n{toml}'))
    assert found["move"][0] == "wrong"
    assert found["actuators"][0] == "note"
    assert {"rl", "rr"} <= {*found["actuators"][1].replace(",", "").split()}


def test_the_preflight_tells_a_control_period_that_differs_from_the_deploy_files(tmp_path):
    deployed(tmp_path)
    backend = opened(tmp_path, 'deploy = "deploy/configs/box.yaml"\ndecimation = 2\n')
    assert levels(backend)["period"][0] == "note"


def exported(folder, names):
    """Return a robot whose policy has these names of joints in its metadata."""
    metadata = {"joint_names": names, "observation_names": "joint_pos", "default_joint_pos": "0,0,0,0"}
    metadata |= {"joint_stiffness": "30,30,30,30", "joint_damping": "1,1,1,1", "action_scale": "0.5"}
    save(folder, "policy.onnx", linear(weights(4, 4), metadata))
    (folder / "box.xml").write_text(quadruped())
    return opened(folder, 'model = "box.xml"\npolicy = "policy.onnx"\ndecimation = 4\nduration = 0.1\n')


def test_a_joint_of_another_name_is_that_of_its_motor_if_the_others_stand_at_theirs(tmp_path):
    trace = exported(tmp_path, "fl,fr,rl,back").rollout({}, 0)
    assert np.array_equal(trace["action"], exported(tmp_path, "fl,fr,rl,rr").rollout({}, 0)["action"])


@pytest.mark.parametrize("names", ["fl,rr,rl,back", "fl,a,b,back"])
def test_a_joint_of_another_name_is_refused_if_the_motors_do_not_tell_it(tmp_path, names):
    with pytest.raises(
        UsageError, match=naming("policy.onnx", "action.joints", "robot.toml", '"fl", "fr", "rl", "rr"')
    ):
        exported(tmp_path, names)


def test_held_joints_equal_position_actuators_with_damped_joints(tmp_path):
    """The policy moves the front legs; gains of the robot file, or of the model, hold the other two."""
    toml = PD.replace("action = {", 'action = { joints = ["fl", "fr"],')
    folders = [tmp_path / "held", tmp_path / "model"]
    model = quadruped()
    for leg in ("rl", "rr"):
        model = model.replace(f'<motor name="{leg}" joint="{leg}"/>', f'<position joint="{leg}" kp="50"/>')
        model = model.replace(f'<joint name="{leg}"', f'<joint name="{leg}" damping="3"')
    held = toml.replace("action = {", "action = { hold = { 'r.' = [50, 3] },")
    traces = []
    for folder, text, xml in zip(folders, (held, toml), (quadruped(), model), strict=True):
        folder.mkdir()
        traces.append(robot(folder, text, 2, xml, outputs=2).rollout({}, 0))
    assert np.array_equal(traces[0]["q"], traces[1]["q"])
    assert abs(traces[0]["q"][-1, 2:]).max() < 0.1


def test_a_file_for_the_real_robot_holds_the_joints_that_the_policy_does_not_move(tmp_path):
    text = GYM.replace("simulation_dt: 0.005\ncontrol_decimation: 4", "control_dt: 0.02")
    for key, value in (("kps", "[30, 30]"), ("kds", "[1, 1]"), ("default_angles", "[0, 0]")):
        text = "\n".join(
            f"{key}: {value}" if line.startswith(f"{key}:") else line for line in text.splitlines()
        )
    text = text.replace("num_actions: 4", "num_actions: 2").replace("num_obs: 23", "num_obs: 17")
    text += "\narm_waist_joint2motor_idx: [3, 2]\narm_waist_kps: [50, 50]\narm_waist_kds: [3, 3]\n"
    backend = deployed(tmp_path, text + "arm_waist_target: [0.3, -0.2]\n", outputs=2)
    assert backend.rollout({}, 0)["q"][-1, 2:] == pytest.approx(np.array([-0.2, 0.3]), abs=0.05)


def test_a_floor_of_the_robot_file_carries_geoms_of_every_group(tmp_path):
    model = quadruped().replace(FLOOR, "").replace('<geom name="', '<geom contype="2" conaffinity="4" name="')
    trace = robot(tmp_path, f"floor = true\n{PD}", 4, model).rollout({}, 0)
    assert trace["height"][-1] == pytest.approx(0.22, abs=0.02)


class Opaque:
    """A policy whose file says nothing of its widths: it takes 4 numbers and returns 3."""

    width = outputs = None
    recurrent = False
    metadata, files, digest, notes = {}, (), "0", ()

    def reset(self):
        pass

    def __call__(self, observation):
        if observation.size != 4:
            raise UsageError("policy.onnx: it takes 4 numbers")
        return np.zeros(3, np.float32)


@pytest.mark.parametrize(
    ("observation", "names"),
    [
        ('["joint_pos_rel"]', ("policy.onnx", "3", "4", "action.joints")),
        ('["base_ang_vel"]', ("base_ang_vel 3",)),
    ],
)
def test_a_policy_whose_file_states_no_width_is_tried_before_a_rollout(
    tmp_path, monkeypatch, observation, names
):
    monkeypatch.setattr("s2r_mujoco.robot.open_policy", lambda path: Opaque())
    backend = robot(tmp_path, PD.replace('["joint_pos_rel"]', observation), 4)
    with pytest.raises(UsageError, match=naming(*names)):
        backend.prepare()


WHEELED = """\
box/roll:
  observations: ["gravity_vec"]
  clip_obs: 50.0
  rl_kp: [30, 30, 0, 0]
  rl_kd: [1, 1, 3, 3]
  num_of_dofs: 4
  action_scale: [0.2, 0.2, 20.0, 20.0]
  wheel_indices: [2, 3]
  default_dof_pos: [0, 0, 0, 0]
  joint_names: [fl, fr, rl, rr]
  dt: 0.005
  decimation: 4
"""


def test_wheels_follow_a_velocity_with_every_kind_of_gains_and_actuator(tmp_path):
    """Torques at every physics step are the measure; the other laws differ by the integrator."""
    options = 'timestep="0.001" integrator="implicitfast"'
    motors = quadruped(options=options).replace('range="-1.2 1.5" limited="true"', "")
    speeds = motors
    for leg in ("rl", "rr"):
        speeds = speeds.replace(f'<motor name="{leg}" joint="{leg}"/>', f'<velocity joint="{leg}" kv="9"/>')
    toml = 'deploy = "config.yaml"\nduration = 0.3\nstart.height = 2.0\n'
    turned = []
    for name, xml, pd in (
        ("torques", motors, ""),
        ("gains", motors, 'action.pd = "implicit"\n'),
        ("own", speeds, ""),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.yaml").write_text(WHEELED)
        turned.append(robot(tmp_path / name, toml + pd, 3, xml).rollout({}, 0)["q"])
    assert abs(turned[0][-1, 2:] - turned[0][0, 2:]).max() > 0.05
    assert turned[1] == pytest.approx(turned[0], abs=5e-3)
    assert turned[2] == pytest.approx(turned[0], abs=5e-3)


def test_a_robot_that_stands_still_is_diagnosed_from_how_it_leans(tmp_path):
    """Nothing pushes it sideways, and its joints move by rounding alone."""
    text = PD.replace("stiffness = 30, damping = 0.8", "stiffness = 3, damping = 0.08, scale = 0.1")
    still = robot(tmp_path, f'{text}command.lin_vel_x = "vd"\n'.replace("0.2", "0.8"), 4)
    spec = parse_spec("signal height {m}\nparam vd {m/s} in [0, 1]\nrequire up: always (height >= 0.1 {m})\n")
    leaning = still.with_effects({"slope": {"left": 3.0}})
    runs = [
        ({"vd": vd}, leaning.rollout({"vd": vd}, k)) for k, vd in enumerate((0.0, 0.5, 1.0, 0.0, 0.5, 1.0))
    ]
    answer = diagnose(spec, still, runs, cache=tmp_path / "cache", where=False, passive=True)
    assert answer.which.answer == ("slope",)
