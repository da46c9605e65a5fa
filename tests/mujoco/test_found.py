"""Found effects in the user's own files: the machine with its fault, and the deploy file without it."""

import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.robots.public import BERKELEY, G1_LAB, G1_LSTM, GO1, ROBOTS
from s2r_mujoco.deploy import read_deployment
from s2r_spec.backend import load_backend
from s2r_spec.errors import UsageError
from tests.errors import naming, states
from tests.mujoco.make_policies import linear
from tests.mujoco.robots import SPIN, opened, quadruped, robot, same, save, weights

OBSERVED = 'observation = ["joint_pos_rel", { term = "joint_vel", scale = 0.05 }, "projected_gravity", "last_action"]\n'
TOML = f"# My robot.\ndecimation = 4  # 20 ms\nduration = 0.4\n{OBSERVED}{SPIN.replace('height = 1.0', 'height = 0.4')}"
GAINS = "action = { scale = 0.1, stiffness = 3, damping = 0.08 }\n"
SERVO = '<position name="{leg}" joint="{leg}" kp="3" kv="0.08" forcerange="-0.6 0.6"/>'
DEPLOY = """\
# The robot's own file.
policy_path: "policy.onnx"
simulation_dt: 0.005
control_decimation: 4
kps: [3, 3, 3.0, 3]  # N*m/rad
kds: [0.08, 0.08, 0.08, 0.08]

default_angles: [0.1, 0.1,
                 -0.1, -0.1]
ang_vel_scale: 0.25
dof_pos_scale: 1.0
dof_vel_scale: 0.05
action_scale: 0.1
cmd_scale: [2.0, 2.0, 0.25]
num_actions: 4
num_obs: 23
"""


def sizes(backend, share=0.3):
    """Return a size of every parameter of every effect, at this share of its range."""

    def size(p):
        return p.nominal + share * ((p.high if p.high > p.nominal else p.low) - p.nominal)

    return {e.name: {p.name: size(p) for p in e.parameters} for e in backend.effects()}


def written(backend, values, folder):
    """Write the files, and return the new robot and what was said of them."""
    findings = backend.write_found(values, folder)
    return load_backend(str(folder / "as_found.toml")), " ".join(one.words for one in findings)


def alike(one, other, seed=3, atol=1e-8, **params):
    return all(
        np.allclose(a, b, rtol=0.0, atol=atol)
        for a, b in zip(
            one.rollout(params, seed).channels.values(), other.rollout(params, seed).channels.values(), strict=True
        )
    )  # fmt: skip


@pytest.mark.parametrize("gains", [GAINS, "action.scale = 0.1\n"], ids=["torques", "servos"])
def test_the_files_equal_the_robot_in_memory_for_every_effect(tmp_path, gains):
    """The first robot computes torques from gains, the second has servos; both fall on a floor."""
    model = quadruped() if gains == GAINS else quadruped(actuator=SERVO)
    box = robot(tmp_path, TOML + gains, 15, model)
    values = sizes(box)
    for name, some in [*((name, {name: own}) for name, own in values.items()), ("all", values)]:
        there, _ = written(box, some, tmp_path / name)
        assert alike(there, box.with_effects(some)), name
        assert not alike(there, box), name
    table = (tmp_path / "all" / "as_found.toml").read_text()
    assert states(table.splitlines()[0], "simulator")
    assert "# My robot." in table
    assert "decimation = 4  # 20 ms" in table
    assert re.search(r"(?s)\[effects\].*action_delay\.time = 0\.03 # s", table)
    assert "dry_friction" not in table


def test_a_robot_file_states_effects_of_its_own(tmp_path):
    box = robot(tmp_path, TOML + GAINS, 15)
    twin = opened(
        tmp_path,
        (tmp_path / "robot.toml").read_text() + "[effects]\naction_delay.time = 0.008\npayload.mass = 0.5\n",
    )
    assert twin.chosen() == {"action_delay": {"time": 0.008}, "payload": {"mass": 0.5}}
    assert same(twin.rollout({}, 1), box.with_effects(twin.chosen()).rollout({}, 1))
    later = load_backend(f"{tmp_path}/robot.toml:payload.mass=0.2")
    assert later.chosen()["payload"] == {"mass": 0.2}
    with pytest.raises(UsageError, match=naming("robot.toml", "payload", "kg")):
        opened(tmp_path, (tmp_path / "robot.toml").read_text().replace("mass = 0.5", "mass = -1"))
    with pytest.raises(UsageError, match=naming("pay_load", "payload")):
        opened(tmp_path, (tmp_path / "robot.toml").read_text().replace("payload", "pay_load"))


def test_comments_and_form_of_the_model_stay(tmp_path):
    model = quadruped().replace("<worldbody>", "<worldbody><!-- two -- hyphens -->\n")
    box = robot(tmp_path, TOML + GAINS, 15, model)
    (kind,) = (p.name for e in box.effects() if e.name == "dry_friction" for p in e.parameters)
    written(box, {"dry_friction": {kind: 0.125}}, tmp_path / "found")
    text = (tmp_path / "found" / "as_found.xml").read_text()
    assert "<!-- two -- hyphens -->" in text
    assert text.count('armature="0.01" frictionloss="0.125"/>') == 4
    bare = re.sub(r' frictionloss="0.125"|\s*<!-- The machine as it was found[^>]*-->', "", text)
    assert bare == model


def test_a_class_of_defaults_stays_and_the_joint_itself_has_the_value(tmp_path):
    model = quadruped(extra="").replace(
        "<worldbody>", '<default><joint frictionloss="0.1"/><motor gear="2"/></default><worldbody>', 1
    )
    box = robot(tmp_path, TOML + "action.scale = 0.1\n", 15, model)
    (kind,) = (p.name for e in box.effects() if e.name == "dry_friction" for p in e.parameters)
    some = {"dry_friction": {kind: 0.125}, "motor_strength": {kind: 0.75}}
    there, _ = written(box, some, tmp_path / "found")
    text = (tmp_path / "found" / "as_found.xml").read_text()
    assert '<default><joint frictionloss="0.1"/>' in text
    assert text.count('frictionloss="0.225"') == 4
    assert text.count("<general name=") == 4  # a motor has no gain of its own
    assert alike(there, box.with_effects(some))


def test_included_files_are_copied_where_they_change_and_meshes_stay(tmp_path):
    home = tmp_path / "robots"
    (home / "parts").mkdir(parents=True)
    (home / "meshes").mkdir()
    cube = [[x, y, z] for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    (home / "meshes" / "cube.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in cube))
    (home / "parts" / "pole.xml").write_text(
        '<mujocoinclude>\n  <body name="pole">\n    <joint name="hinge" axis="0 1 0"/>  <!-- by hand -->\n'
        '    <geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.02" mass="0.2"/>\n  </body>\n</mujocoinclude>\n'
    )
    (home / "parts" / "sensors.xml").write_text(
        '<mujocoinclude><sensor><jointpos name="angle" joint="hinge"/></sensor></mujocoinclude>'
    )
    (home / "cart.xml").write_text(
        '<mujoco>\n  <compiler meshdir="meshes"/>\n  <asset><mesh file="cube.obj"/></asset>\n  <worldbody>\n'
        '    <body name="cart">\n      <joint name="slide" type="slide" axis="1 0 0"/>\n'
        '      <geom type="mesh" mesh="cube"/>\n      <include file="parts/pole.xml"/>\n    </body>\n  </worldbody>\n'
        '  <actuator><motor name="push" joint="slide"/></actuator>\n  <include file="parts/sensors.xml"/>\n</mujoco>\n'
    )
    (home / "control.py").write_text(
        "def act(model, data, command):\n    return [3 * data.qpos[0] + 5 * data.qvel[0] + 40 * data.qpos[1] + 8]\n"
    )
    cart = opened(home, 'model = "cart.xml"\npolicy = "control.py:act"\ndecimation = 5\nduration = 0.5\n')
    some = {"dry_friction": {"hinge": 0.1}, "payload": {"mass": 0.3}, "action_delay": {"time": 0.01}}
    there, _ = written(cart, some, tmp_path / "found")
    assert {one.name for one in (tmp_path / "found").iterdir()} == {
        "as_found.toml", "as_found.xml", "as_found_pole.xml",
    }  # fmt: skip
    assert alike(there, cart.with_effects(some))
    main, part = ((tmp_path / "found" / name).read_text() for name in ("as_found.xml", "as_found_pole.xml"))
    assert 'file="../robots/parts/sensors.xml"' in main
    assert 'axis="0 1 0" frictionloss="0.1"/>  <!-- by hand -->' in part
    assert '\n      <inertial mass="' in main


def test_what_a_test_parameter_would_overwrite_is_in_the_robot_file(tmp_path):
    """Damping that a test sets, a body from a pattern, and a floor that only the robot file adds."""
    model = quadruped().replace('<geom name="floor" type="plane" size="0 0 0.1"/>', "")
    drag = 'parameters.drag = { field = "joint/??/damping/0", range = [0, 1] }\n'
    box = robot(tmp_path, TOML + "floor = true\n" + GAINS + drag, 15, model)
    (kind,) = (p.name for e in box.effects() if e.name == "dry_friction" for p in e.parameters)
    some = {"dry_friction": {kind: 0.2}, "viscous_friction": {kind: 0.01}, "ground_friction": {"factor": 0.5}}
    there, words = written(box, some, tmp_path / "found")
    assert there.chosen() == {name: some[name] for name in ("ground_friction", "viscous_friction")}
    assert states(words, "as_found.xml", "dry_friction", "[effects]", "ground_friction", "viscous_friction")
    for drag in (0.0, 0.4):
        assert alike(there, box.with_effects(some), drag=drag)


def test_a_model_in_another_format_stays_and_the_robot_file_has_all(tmp_path):
    (tmp_path / "box.urdf").write_text(
        '<robot name="box"><link name="base"/><link name="arm"><inertial><mass value="1"/><inertia ixx="0.1" ixy="0" '
        'ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link><joint name="turn" type="continuous">'
        '<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint></robot>'
    )
    (tmp_path / "control.py").write_text("def act(model, data, command):\n    return [1.0]\n")
    arm = opened(
        tmp_path,
        'model = "box.urdf"\nmotors = true\npolicy = "control.py:act"\ndecimation = 5\nduration = 0.2\n',
    )
    there, _ = written(arm, {"dry_friction": {"turn": 0.3}}, tmp_path / "found")
    assert [one.name for one in (tmp_path / "found").iterdir()] == ["as_found.toml"]
    assert same(there.rollout({}, 0), arm.with_effects({"dry_friction": {"turn": 0.3}}).rollout({}, 0))


def deployed(folder):
    save(folder, "policy.onnx", linear(weights(4, 23)))
    (folder / "deploy.yaml").write_text(DEPLOY)
    (folder / "box.xml").write_text(quadruped())
    start = "start = { height = 1, joint_pos = { fl = 0.2, fr = 0.15, rl = 0, rr = -0.1 } }\n"
    return opened(folder, f'model = "box.xml"\ndeploy = "deploy.yaml"\nduration = 0.6\n{start}')


FAULTS = {
    "kp": {"joint": 0.8}, "kd": {"joint": 1.25}, "motor_strength": {"joint": 0.9}, "encoder_offset": {"joint": 0.05},
}  # fmt: skip


def test_the_fix_makes_the_machine_the_robot_that_was_meant(tmp_path):
    """The machine has the fault; with the file it moves as the simulator without any."""
    box = deployed(tmp_path)
    meant = box.rollout({}, 0)
    _, words = written(box, FAULTS | {"action_delay": {"time": 0.004}}, tmp_path / "found")
    assert states(words, "fix.yaml", "deploy.yaml", "kp", "undoes action_delay")
    text = (tmp_path / "found" / "fix.yaml").read_text()
    assert "# N*m/rad" in text
    assert "\n\ndefault_angles: [0.15, 0.15,\n                 -0.05, -0.05]\nang_vel_scale: 0.25" in text
    before, after = (read_deployment(tmp_path / name) for name in ("deploy.yaml", "found/fix.yaml"))
    assert np.allclose(after.stiffness, 3.0 / (0.8 * 0.9), rtol=1e-5)
    assert np.allclose(after.damping, 0.08 / (1.25 * 0.9), rtol=1e-5)
    assert after.action_scale == before.action_scale
    (tmp_path / "deploy.yaml").write_text(text)
    cured = load_backend(str(tmp_path / "robot.toml")).with_effects(FAULTS)
    trace = cured.rollout({}, 0)
    assert np.allclose(trace["q"] - 0.05, meant["q"], atol=1e-3)
    assert np.allclose(trace["vz"], meant["vz"], atol=1e-3)


def test_a_fix_that_the_file_cannot_say_is_said(tmp_path):
    box = deployed(tmp_path)
    path = tmp_path / "deploy.yaml"
    path.write_text(
        DEPLOY.replace("[3, 3, 3.0, 3]", "&kp [3, 3, 3.0, 3]").replace("[0.08, 0.08, 0.08, 0.08]", "*kp")
    )
    box = load_backend(str(tmp_path / "robot.toml"))
    _, words = written(box, {"kp": {"joint": 0.8}}, tmp_path / "one")
    assert states(words, "fix.yaml is not written", "deploy.yaml")
    _, words = written(box, {"action_delay": {"time": 0.004}}, tmp_path / "two")
    assert states(words, "fix.yaml is not written", "action_delay")
    assert {one.name for one in (tmp_path / "two").iterdir()} == {"as_found.toml"}


def test_nothing_is_overwritten(tmp_path):
    box = deployed(tmp_path)
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match=naming("found")):
        box.write_found(FAULTS, tmp_path / "found")
    assert [one.name for one in (tmp_path / "found").iterdir()] == ["mine.txt"]
    (tmp_path / "empty").mkdir()
    written(box, FAULTS, tmp_path / "empty")
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".")]


@pytest.mark.skipif(
    not (ROBOTS / "README.md").exists(), reason="the public robots are not beside the checkout"
)
@pytest.mark.parametrize("text", [GO1, BERKELEY, G1_LAB, G1_LSTM], ids=["go1", "berkeley", "g1", "g1 lstm"])
def test_public_robots_are_written_with_every_effect(tmp_path, text):
    robot = replace(opened(tmp_path, text + "duration = 0.5\n"), duration=0.5)
    values = sizes(robot, 0.1)
    there, _ = written(robot, values, tmp_path / "found")
    assert alike(there, robot.with_effects(values), atol=1e-6, vd=0.5)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "found" / "as_found.xml"))
    assert model.nu > 0


def test_the_page_has_the_figures_of_the_cart_pole():
    root = Path(__file__).parents[2]
    kept = json.loads((root / "benchmarks" / "results" / "cart_pole.json").read_text())
    page = (root / "docs" / "how-to" / "policies.md").read_text()
    page = " ".join(page.split())
    fresh = kept["fresh"]
    assert [one["seed"] for one in fresh] == kept["seeds"]  # none is left out
    both = sum(one["named"] == ["dry_friction", "action_delay"] for one in fresh)
    assert f"names both on {both} of {len(fresh)} machines" in page

    def span(values, digits=0):
        return f"{min(values):.{digits}f} to {max(values):.{digits}f}"

    friction = [one["sizes"]["dry_friction"]["slider"] for one in fresh]
    delay = [1e3 * one["sizes"]["action_delay"]["time"] for one in fresh]
    assert f"{span(friction, 1)} N and {span(delay, 1)} ms" in page
    for key, words in (("named alone", "close {} % of the gap"), ("tuned", "those of `--tuned` {} %")):
        assert words.format(span([100 * one[key]["closed"] for one in fresh])) in page
    for answers in kept["set-ups tried before"].values():
        for answer in answers:
            assert all(number in page for number in re.findall(r"\d\.\d+", answer))
