"""Effects of a robot file: each does to the robot what its name says, and nothing at its nominal value."""

import numpy as np
import pytest

from s2r_mujoco.effects.kinds import kind_name
from s2r_spec.backend import load_backend
from s2r_spec.effects import catalogue_of
from s2r_spec.errors import UsageError
from tests.errors import naming
from tests.mujoco.robots import SPIN, opened, robot, same

TOML = (
    "decimation = 4\nduration = 0.4\n"
    'observation = ["joint_pos_rel", { term = "joint_vel", scale = 0.05 }, "projected_gravity", "last_action"]\n'
    + SPIN
    + "action = { scale = 0.1, stiffness = 3, damping = 0.08 }\n"
)
WIDTH = 15
KP, KD = 3.0, 0.08


@pytest.fixture
def box(tmp_path):
    return robot(tmp_path, TOML, WIDTH)


def nominal(backend):
    return {e.name: {p.name: p.nominal for p in e.parameters} for e in backend.effects()}


def test_the_catalogue_has_scales_and_nothing_at_its_nominal_values(box):
    names = [effect.name for effect in catalogue_of(box)]
    assert {"dry_friction", "motor_strength", "kp", "action_delay", "payload", "imu_tilt", "slope"} <= {
        *names
    }
    assert "torque_limit" not in names  # the model states none
    assert same(box.with_effects(nominal(box)).rollout({}, 3), box.rollout({}, 3))
    assert box.with_effects(nominal(box)).model_hash != box.model_hash


@pytest.mark.parametrize(
    ("effect", "field"),
    [
        ("dry_friction", "joint/??/frictionloss"),
        ("armature", "joint/??/armature"),
        ("viscous_friction", "joint/??/damping/0"),
    ],
)
def test_an_effect_of_joints_is_the_field_of_the_model(tmp_path, effect, field):
    plain = robot(tmp_path, TOML + f'parameters.size = {{ field = "{field}", how = "add" }}\n', WIDTH)
    (parameter,) = (p for e in plain.effects() if e.name == effect for p in e.parameters)
    size = 0.8 * parameter.high
    trace = plain.with_effects({effect: {parameter.name: size}}).rollout({}, 1)
    # The model compiles with rounding of its own, so the two agree to about 1e-12.
    assert np.allclose(trace["q"], plain.rollout({"size": size}, 1)["q"], atol=1e-9)
    assert np.abs(trace["q"] - plain.rollout({}, 1)["q"]).max() > 1e-3


def test_gains_are_those_of_another_file(box, tmp_path):
    names = [p.name for e in box.effects() if e.name == "kp" for p in e.parameters]
    changed = box.with_effects({"kp": dict.fromkeys(names, 1.2), "kd": dict.fromkeys(names, 0.5)})
    trace = changed.rollout({}, 1)
    other = opened(
        tmp_path,
        'model = "box.xml"\npolicy = "policy.onnx"\n'
        + TOML.replace("stiffness = 3, damping = 0.08", "stiffness = 3.6, damping = 0.04"),
    )
    assert np.allclose(trace["q"], other.rollout({}, 1)["q"], atol=1e-9)


def test_a_weak_motor_gives_less_torque(box):
    names = [p.name for e in box.effects() if e.name == "motor_strength" for p in e.parameters]
    trace = box.with_effects({"motor_strength": dict.fromkeys(names, 0.5)}).rollout({}, 1)
    assert np.allclose(trace["tau"], 0.5 * (KP * (trace["target"] - trace["q"]) - KD * trace["dq"]))


@pytest.mark.parametrize("ticks", [1.0, 0.5])
def test_the_policy_and_the_log_have_the_robot_as_it_was(box, ticks):
    trace = box.with_effects({"observation_delay": {"time": 0.02 * ticks}}).rollout({}, 1)
    assert np.allclose(trace["obs"][:, :4], trace["q"], atol=1e-6)
    assert np.allclose(trace["obs"][:, 4:8], 0.05 * trace["dq"], atol=1e-5)
    assert np.allclose(
        trace["obs"][1:, 11:], trace["action"][:-1], atol=1e-6
    )  # of its own action nothing is late
    if ticks == 1.0:  # the motors have the state of now, which the log has one tick later
        now = KP * (trace["target"][:-1] - trace["q"][1:]) - KD * trace["dq"][1:]
        assert np.allclose(trace["tau"][:-1], now)


def test_targets_reach_the_motors_later(box):
    trace = box.with_effects({"action_delay": {"time": 0.02}}).rollout({}, 1)
    late = KP * (trace["target"][:-1] - trace["q"][1:]) - KD * trace["dq"][1:]
    assert np.allclose(trace["tau"][1:], late)
    drawn = box.with_effects({"action_delay": {"time": 0.02, "jitter": 0.3}})
    assert same(drawn.rollout({}, 1), drawn.rollout({}, 1))
    assert not np.array_equal(drawn.rollout({}, 1)["q"], drawn.rollout({}, 2)["q"])


def test_an_offset_of_encoders_is_in_the_log_the_observation_and_the_torque(box):
    names = [p.name for e in box.effects() if e.name == "encoder_offset" for p in e.parameters]
    trace = box.with_effects({"encoder_offset": dict.fromkeys(names, 0.1)}).rollout({}, 1)
    assert np.allclose(trace["obs"][:, :4], trace["q"], atol=1e-6)
    assert np.allclose(trace["q"][0], box.rollout({}, 1)["q"][0] + 0.1)
    assert np.allclose(trace["tau"], KP * (trace["target"] - trace["q"]) - KD * trace["dq"])


def test_a_tilted_imu_and_a_biased_gyroscope_measure_so(box):
    still, tilted = box.rollout({}, 1), box.with_effects({"imu_tilt": {"pitch": 3.0}}).rollout({}, 1)
    gravity = still["obs"][0, 8:11].astype(float)
    c, s = np.cos(np.radians(3.0)), np.sin(np.radians(3.0))
    about_y = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    assert np.allclose(tilted["obs"][0, 8:11], about_y @ gravity, atol=1e-6)
    biased = box.with_effects({"gyro_bias": {"z": 0.1}}).rollout({}, 1)
    assert np.allclose(biased["gyro"][0] - still["gyro"][0], [0.0, 0.0, 0.1])


def test_on_a_slope_gravity_leans(box):
    level, trace = box.rollout({}, 1), box.with_effects({"slope": {"forward": 5.0}}).rollout({}, 1)
    w, *v = level["quaternion"][0]
    leaning = np.array([np.sin(np.radians(5.0)), 0.0, -np.cos(np.radians(5.0))])
    turn = -2.0 * np.cross(v, w * leaning - np.cross(v, leaning))  # by the inverse of the attitude
    assert np.allclose(trace["obs"][0, 8:11], leaning + turn, atol=1e-6)


@pytest.mark.parametrize(
    "effect", [{"slope": {"forward": 5.0, "left": 3.0}}, {"imu_tilt": {"roll": 2.0, "pitch": -3.0}}, {}]
)
def test_the_attitude_of_a_log_is_that_of_an_imu(box, effect):
    trace = box.with_effects(effect).rollout({}, 1)
    assert np.allclose(trace["obs"][:, 8:11], trace["gravity"], atol=1e-6)


def test_a_controller_in_python_has_delays_and_no_errors_of_sensing(tmp_path):
    (tmp_path / "control.py").write_text(
        "def act(model, data, command):\n    return 4 * [float(data.time)]\n"
    )
    backend = robot(tmp_path, 'policy = "control.py:act"\ndecimation = 4\nduration = 0.2\nstart.height = 1\n')
    names = {effect.name for effect in backend.effects()}
    assert "action_delay" in names
    assert not names & {"observation_delay", "encoder_offset", "imu_tilt"}
    trace = backend.with_effects({"action_delay": {"time": 0.02}}).rollout({}, 0)
    assert np.allclose(trace["tau"][1:], trace["ctrl"][:-1])


def test_effects_are_options_after_the_colon(box, tmp_path):
    name = next(p.name for e in box.effects() if e.name == "dry_friction" for p in e.parameters)
    twin = load_backend(f"{tmp_path}/robot.toml:dry_friction.{name}=0.2,payload.mass=0.5")
    assert twin.chosen() == {"dry_friction": {name: 0.2}, "payload": {"mass": 0.5}}
    assert same(twin.rollout({}, 1), box.with_effects(twin.chosen()).rollout({}, 1))
    with pytest.raises(UsageError, match=naming("dry_fiction", "dry_friction")):
        box.with_effects({"dry_fiction": {name: 0.2}})
    with pytest.raises(UsageError, match=naming("payload", "mass", "kg")):
        box.with_effects({"payload": {"mass": -1.0}})


@pytest.mark.parametrize(
    ("joint", "kind"),
    [
        ("FL_hip_joint", "hip"), ("left_hip_pitch_joint", "hip_pitch"), ("RR_calf", "calf"), ("LF_HAA", "haa"),
        ("joint3", "joint3"), ("slider", "slider"), ("leftKnee", "knee"), ("fl", "joint"),
    ],
)  # fmt: skip
def test_a_kind_is_the_name_without_its_side(joint, kind):
    assert kind_name(joint) == kind


def test_robots_of_many_kinds_share_one_size_in_parts_of_each_scale(tmp_path):
    legs = "".join(
        f'<body name="b{i}" pos="{i} 0 1"><joint name="axis{i}" axis="0 1 0" actuatorfrclimited="true" '
        f'actuatorfrcrange="{-(i + 1)} {i + 1}"/><geom size="0.1" mass="1"/></body>'
        for i in range(6)
    )
    motors = "".join(f'<motor name="m{i}" joint="axis{i}"/>' for i in range(6))
    (tmp_path / "arm.xml").write_text(
        f"<mujoco><worldbody>{legs}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    (tmp_path / "hold.py").write_text("def act(model, data, command):\n    return 6 * [0.0]\n")
    arm = opened(tmp_path, 'model = "arm.xml"\npolicy = "hold.py:act"\ndecimation = 5\nduration = 0.1\n')
    (friction,) = (e for e in arm.effects() if e.name == "dry_friction")
    assert [(p.name, p.unit) for p in friction.parameters] == [("hinges", "")]
    added = arm._robot.physics((("dry_friction", (("hinges", 1.0),)),))
    assert np.allclose(added.friction, 0.05 * np.arange(1, 7))


def test_variants_are_the_same_physics(box):
    box = box.with_duration(0.1)
    for name, variant in box.variants().items():
        trace = variant.rollout({}, 1)
        assert len(trace.times) == len(box.rollout({}, 1).times)
        assert np.allclose(trace["q"], box.rollout({}, 1)["q"], atol=0.05)
        assert variant.model_hash != box.model_hash, name
    half = box.variants()["half the time step"]
    assert not np.array_equal(half.rollout({}, 1)["q"], box.rollout({}, 1)["q"])
