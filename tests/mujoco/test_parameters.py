"""No parameter and no key is ignored: each changes the motion as it says, or is refused."""

from pathlib import Path

import numpy as np
import pytest

from s2r_spec.errors import UsageError
from tests.mujoco.robots import opened, quadruped, robot

START = "start.joint_pos = { fl = 0.4 }\n"
TERMS = 'decimation = 4\nduration = 0.3\nobservation = ["joint_pos", "base_ang_vel"]\naction.scale = 0.3\n'
GAINS = TERMS + "action.stiffness = 20\naction.damping = 0.5\n"


def pushed(name: str, at: float) -> str:
    return f'parameters.{name} = {{ push = "trunk", at = "{at} s", for = "0.1 s", range = [0, 50] }}\n'


def test_two_pushes_on_one_body_add_up(tmp_path):
    both = robot(tmp_path, GAINS + pushed("a", 0.0) + pushed("b", 0.04), 7)
    found = {test: both.rollout(dict.fromkeys(test, 20.0), 0)["vx"] for test in ("", "a", "b", "ab")}
    assert len({values.tobytes() for values in found.values()}) == 4
    assert found["ab"][4] > max(found["a"][4], found["b"][4]) + 0.05


@pytest.mark.parametrize("pd", ["explicit", "implicit"])
@pytest.mark.parametrize("field", ["gear/0", "gainprm/0"])
def test_a_weaker_motor_gives_less_torque(tmp_path, pd, field):
    """Half the strength equals half of both gains."""
    text = TERMS + START + f'action.pd = "{pd}"\n'
    strength = f'parameters.strength = {{ field = "actuator/*/{field}", how = "scale", range = [0.5, 1] }}\n'
    weak = robot(tmp_path, text + "action.stiffness = 20\naction.damping = 0.5\n" + strength, 7)
    found, full = weak.rollout({"strength": 0.5}, 0), weak.rollout({}, 0)
    wanted = robot(tmp_path, text + "action.stiffness = 10\naction.damping = 0.25\n", 7).rollout({}, 0)
    assert np.allclose(found["q"], wanted["q"], rtol=0, atol=1e-9)
    assert not np.allclose(found["q"], full["q"], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        (GAINS + 'parameters.dt = { field = "option/timestep", range = [0.001, 0.005] }\n', "parameters.dt"),
        (GAINS + 'parameters.a = { push = "trunk", direction = [0, 0, 0] }\n', "direction"),
        (GAINS + 'parameters.a = { push = "world" }\n', "fixed"),
        (GAINS + 'parameters.m = { field = "geom/trunk/mass", unit = "g" }\n', "in kg"),
        (GAINS + 'parameters.m = { field = "geom/trunk/mass", unit = "m" }\n', "in kg"),
        (GAINS + 'parameters.m = { field = "geom/trunk/mass", range = [5, 1] }\n', "above"),
        (GAINS + "start.joint_pos = { fl = 30 }\n", "fl is outside its limits .* rad"),
        (TERMS + "action.damping = 1\n", "action.stiffness"),
        (TERMS + 'action.pd = "implicit"\n', "action.stiffness"),
    ],
)
def test_a_key_without_effect_is_refused(tmp_path, text, facts):
    with pytest.raises(UsageError, match=facts):
        robot(tmp_path, text, 7)


def test_a_second_free_body_does_not_lift_the_robot(tmp_path):
    ball = '<body pos="2 0 0.05"><freejoint/><geom size="0.05"/></body></worldbody>'
    alone = robot(tmp_path, GAINS, 7).rollout({}, 0)
    beside = robot(tmp_path, GAINS, 7, quadruped().replace("</worldbody>", ball)).rollout({}, 0)
    assert beside["z"][0] == alone["z"][0] < 0.25


@pytest.mark.parametrize(
    ("field", "unit"),
    [
        ("joint/slide/damping/0", "N*s/m"),
        ("joint/hinge/damping/0", "N*m*s/rad"),
        ("joint/*/damping/0", ""),
        ("joint/slide/range/1", "m"),
        ("joint/hinge/ref", "deg"),
        ("joint/sl*/armature", "kg"),
        ("body/cart/gravcomp", ""),
    ],
)
def test_the_unit_of_a_field_is_that_of_its_joint(tmp_path, field, unit):
    (tmp_path / "c.py").write_text("def act(model, data, command):\n    return [0.0]\n")
    (tmp_path / "cart.xml").write_text((Path(__file__).parent / "cart.xml").read_text())
    text = (
        f'model = "cart.xml"\npolicy = "c.py:act"\ndecimation = 2\nparameters.p = {{ field = "{field}" }}\n'
    )
    (parameter,) = opened(tmp_path, text).parameters
    assert parameter.unit == unit


def test_a_run_does_not_mix_two_versions_of_a_model(tmp_path):
    text = GAINS + 'parameters.grip = { field = "geom/floor/friction/0", range = [0.5, 1.5] }\n'
    backend = robot(tmp_path, text, 7)
    before = backend.rollout({"grip": 0.7}, 0)
    (tmp_path / "box.xml").write_text(quadruped().replace('mass="3"', 'mass="4"'))
    with pytest.raises(UsageError, match="changed"):
        backend.rollout({"grip": 0.8}, 0)
    after = opened(tmp_path, (tmp_path / "robot.toml").read_text())
    assert after.model_hash != backend.model_hash
    assert not np.array_equal(after.rollout({"grip": 0.7}, 0)["q"], before["q"])
