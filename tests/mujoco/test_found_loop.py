"""Mistakes of a loop in the user's own files: the machine with them, and the deploy file that undoes a factor."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.robots.public import GO1, ROBOTS
from s2r_mujoco.deploy import read_deployment
from s2r_spec import load_backend, write_trace
from tests.errors import states
from tests.mujoco.make_policies import HERE
from tests.mujoco.robots import opened, robot, same
from tests.mujoco.test_cart import COMMON, STATE
from tests.mujoco.test_found import DEPLOY, GAINS, TOML, alike, deployed

OWN = TOML.replace('["joint_pos_rel", {', '[\n  "joint_pos_rel",  # first\n  {').replace(
    '}, "proj', '},  # slow\n  "proj'
)


def named(box, name):
    """Return the mistake of a robot that has this name."""
    (found,) = (one for one in box.mistakes() if one.name == name)
    return found


def written(box, folder, mistakes, values=None):
    """Write the files, and return the new robot and what was said of them."""
    findings = box.write_found(values or {}, folder, mistakes)
    return load_backend(str(folder / "as_found.toml")), " ".join(
        line for one in findings for line in (one.words, *one.table)
    )


@pytest.mark.parametrize("stated", ["robot file", "deploy file"])
def test_the_files_equal_the_robot_in_memory_for_every_mistake(tmp_path, stated):
    box = robot(tmp_path, OWN + GAINS, 15) if stated == "robot file" else deployed(tmp_path)
    mistakes = box.mistakes()
    assert len(mistakes) > 50
    for number, one in enumerate(mistakes):
        there, words = written(box, tmp_path / f"found{number}", [one])
        assert same(there.rollout({}, 3), box.with_mistakes([one]).rollout({}, 3)), one.name
        assert one.name in words


def test_two_mistakes_and_effects_are_one_robot(tmp_path):
    box = robot(tmp_path, OWN + GAINS, 15)
    first = named(box, "joint_vel is 1 tick late")
    second = named(box.with_mistakes([first]), "target has 0.5 times the scale of the action")
    effects = {"action_delay": {"time": 0.008}, "payload": {"mass": 0.5}}
    there, words = written(box, tmp_path / "found", [first, second], effects)
    machine = box.with_mistakes([first, second]).with_effects(effects)
    assert alike(there, machine)
    assert states(words, first.name, second.name, "action_delay")


def test_comments_and_the_other_terms_stay(tmp_path):
    box = robot(tmp_path, OWN + GAINS, 15)
    written(box, tmp_path / "found", [named(box, "joint_vel has no scale")])
    text = (tmp_path / "found" / "as_found.toml").read_text()
    lines = text.splitlines()
    assert '  "joint_pos_rel",  # first' in lines
    (changed,) = (line for line in lines if line.endswith("# slow"))
    assert "scale = [1.0, 1.0, 1.0, 1.0]" in changed
    assert "decimation = 4  # 20 ms" in lines
    assert GAINS.strip(" }\n") in text


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("joint_vel is 2 times as large", "dof_vel_scale: 0.025"),
        ("base_ang_vel has the wrong sign", "ang_vel_scale: -0.25"),
        ("velocity_commands has the wrong sign", "cmd_scale: [-2, -2, -0.25]"),
        ("target has 0.5 times the scale of the action", "action_scale: 0.2"),
        ("target has the wrong sign of the action", "action_scale: -0.1"),
    ],
)
def test_the_fix_undoes_a_factor(tmp_path, name, line):
    """The machine's code has the factor; with the other file it moves as the simulator without it."""
    box = deployed(tmp_path)
    meant = box.rollout({}, 0)
    _, words = written(box, tmp_path / "found", [named(box, name)])
    assert states(words, "fix.yaml", name)
    text = (tmp_path / "found" / "fix.yaml").read_text()
    kept = [one for one in text.splitlines()[1:] if one not in DEPLOY.splitlines()]
    assert kept == [line]
    (tmp_path / "deploy.yaml").write_text(text)
    cured = load_backend(str(tmp_path / "robot.toml"))
    again = cured.with_mistakes([named(cured, name)]).rollout({}, 0)
    assert same(replace(again, meta={}), replace(meant, meta={}))


def test_a_factor_is_undone_beside_gains(tmp_path):
    box = deployed(tmp_path)
    mistakes = [named(box, "joint_vel is 2 times as large")]
    written(box, tmp_path / "found", mistakes, {"kp": {"joint": 0.8}, "action_delay": {"time": 0.004}})
    fix = read_deployment(tmp_path / "found" / "fix.yaml")
    assert fix.stiffness == pytest.approx([3.75] * 4)
    assert [one.scale for one in fix.terms if one.name == "joint_vel"] == [(0.025,)]


@pytest.mark.parametrize(
    "name",
    ["joint_vel is 1 tick late", "joint_vel has no scale", "joint_vel is scaled twice", "joint_vel is always zero",
     "base_ang_vel is in axes of the world", "target has no default pose", "target has no scale of the action"],
)  # fmt: skip
def test_what_only_other_code_undoes_is_said(tmp_path, name):
    box = deployed(tmp_path)
    _, words = written(box, tmp_path / "found", [named(box, name)])
    assert states(words, "fix.yaml is not written", "correct in the code", name)
    assert not (tmp_path / "found" / "fix.yaml").exists()


def test_a_factor_that_the_file_has_for_all_joints_alike_is_said(tmp_path):
    box = deployed(tmp_path)
    _, words = written(box, tmp_path / "found", [named(box, "base_ang_vel has the wrong sign in x")])
    assert states(words, "fix.yaml is not written", "deploy.yaml cannot say it", "-0.25 0.25 0.25")


def test_without_a_deploy_file_there_is_no_fix(tmp_path):
    box = robot(tmp_path, OWN + GAINS, 15)
    _, words = written(box, tmp_path / "found", [named(box, "joint_vel is 2 times as large")])
    assert states(words, "no deploy file", "correct in the code", "joint_vel is 2 times as large")


@pytest.mark.skipif(
    not (ROBOTS / "README.md").exists(), reason="the public robots are not beside the checkout"
)
def test_a_public_robot_is_written_with_mistakes(tmp_path):
    go1 = replace(opened(tmp_path, GO1 + "duration = 0.5\n"), duration=0.5)
    for number, one in enumerate([*go1.mistakes()][::12]):
        there, _ = written(go1, tmp_path / f"found{number}", [one])
        assert same(
            replace(there, duration=0.5).rollout({"vd": 0.5}, 1),
            go1.with_mistakes([one]).rollout({"vd": 0.5}, 1),
        )


def test_a_diagnosis_writes_the_mistake_that_it_names(tmp_path, s2r):
    for name in ("cart.xml", "cart.onnx"):
        (tmp_path / name).write_bytes((HERE / name).read_bytes())
    (tmp_path / "near.stl").write_text(
        "signal q_slide {m}\nrequire near: always[0, 1 s] (abs(q_slide) <= 1)\n"
    )
    cart = opened(tmp_path, f'policy = "cart.onnx"\n{COMMON}{STATE}')
    (mistake,) = (one for one in cart.mistakes() if one.name == "joint_vel is 0.25 times as large")
    (tmp_path / "run").mkdir()
    machine = replace(cart.with_mistakes([mistake]), duration=1.0)
    for seed in range(8):
        write_trace(machine.rollout({}, seed), tmp_path / "run" / f"{seed}.npz")
    (tmp_path / "run" / "rollouts.csv").write_text("id\n" + "".join(f"{k}\n" for k in range(8)))
    words = ("diagnose", "near.stl", "--sim", "robot.toml", "--real", "log:run", "--as-found", "found")
    assert states(s2r(*words, "-q").stderr, "found/as_found.toml", mistake.name)
    there = load_backend(str(tmp_path / "found" / "as_found.toml"))
    assert same(there.rollout({}, 3), cart.with_mistakes([mistake]).rollout({}, 3))
