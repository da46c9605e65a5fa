"""The channels of a trace against formulas of the tests' own, and which channels a robot has."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import s2r_spec
from s2r_spec.runs.scorer import Scorer
from tests.mujoco.robots import LEGS, SPIN, opened, robot

FAST = SPIN.replace("ang_vel = 1", "ang_vel = 5")
BASE = f'decimation = 1\ntimestep = 0.001\nduration = 0.3\nobservation = ["joint_pos"]\n{FAST}'
PARALLEL = """<mujoco><option timestep="0.01"/><worldbody><body name="arm">
  <joint name="lift" type="slide" axis="0 0 1" damping="1"/><geom size="0.05" mass="1"/>
  <body name="fore" pos="0.1 0 0"><joint name="turn" axis="0 1 0" damping="0.1"/><geom size="0.05" mass="0.5"/>
  <site name="tip" pos="0.1 0 0"/>
  <body name="ball" pos="0.1 0 0"><joint name="shoulder" type="ball"/><geom size="0.02" mass="0.1"/></body></body>
  </body></worldbody>
  <actuator><motor name="up" joint="lift"/><motor joint="turn"/></actuator>
  <sensor>
    <jointpos name="lifted" joint="lift"/><jointvel name="turning" joint="turn"/><jointpos name="turned" joint="turn"/>
    <framepos name="tip" objtype="site" objname="tip"/><force name="load-cell" site="tip"/><torque site="tip"/>
    <actuatorfrc name="q" actuator="up"/><clock name="1st"/><touch name="touch" site="tip"/>
    <jointactuatorfrc name="effort" joint="lift"/><framequat name="way" objtype="site" objname="tip"/>
  </sensor></mujoco>"""
ACT = "def act(model, data, command):\n    return [3.0, -0.25]\n"


@pytest.fixture
def trace(tmp_path):
    return robot(tmp_path, BASE, 4).rollout({}, 3)


def column(trace, *names):
    return np.stack([trace[name] for name in names], axis=1)


def test_velocities_of_the_base_are_derivatives_of_its_position_and_attitude(trace):
    position = column(trace, "x", "y", "z")
    velocity = np.gradient(position, trace.times, axis=0)[2:-2]
    turned = Rotation.from_quat(np.array(trace["quaternion"]), scalar_first=True)
    np.testing.assert_allclose(turned.apply(np.array(trace["velocity"]))[2:-2], velocity, atol=0.02)
    step = (turned[:-1].inv() * turned[1:]).as_rotvec() / 0.001
    np.testing.assert_allclose(trace["omega"][1:], step, atol=1e-3)
    assert np.linalg.norm(trace["omega"], axis=1).max() > 1


def test_roll_pitch_yaw_are_the_angles_of_the_attitude(trace):
    turned = Rotation.from_quat(np.array(trace["quaternion"]), scalar_first=True)
    yaw, pitch, roll = turned.as_euler("ZYX").T
    np.testing.assert_allclose(trace["roll"], roll, atol=1e-9)
    np.testing.assert_allclose(trace["pitch"], pitch, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * trace["yaw"]), np.exp(1j * yaw), atol=1e-9)
    np.testing.assert_allclose(trace["gravity"], turned.inv().apply([0.0, 0.0, -1.0]), atol=1e-9)
    assert np.abs(trace["pitch"]).max() > 0.2


def test_the_heading_frame_has_speed_forward_and_left_and_the_rate_of_the_heading(trace):
    """The heading is that of the base's forward axis in the horizontal plane."""
    turned = Rotation.from_quat(np.array(trace["quaternion"]), scalar_first=True)
    forward = turned.apply([1.0, 0.0, 0.0])
    forward = forward[:, :2] / np.linalg.norm(forward[:, :2], axis=1)[:, None]
    world = turned.apply(np.array(trace["velocity"]))
    np.testing.assert_allclose(trace["vx"], (world[:, :2] * forward).sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(
        trace["vy"], forward[:, 0] * world[:, 1] - forward[:, 1] * world[:, 0], atol=1e-9
    )
    np.testing.assert_allclose(trace["vz"], world[:, 2], atol=1e-9)
    heading = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    np.testing.assert_allclose(trace["wz"][2:-2], np.gradient(heading, trace.times)[2:-2], atol=0.01)


def test_the_yaw_goes_on_beyond_half_a_turn(tmp_path):
    text = BASE.replace("base_ang_vel = 5", "base_ang_vel = 30").replace("joint_vel = 1", "joint_vel = 0")
    yaw = robot(tmp_path, text, 4).rollout({}, 1)["yaw"]
    assert np.abs(np.diff(yaw)).max() < 1
    assert np.ptp(yaw) > np.pi


def test_a_legged_robot_has_these_channels_and_units(tmp_path):
    backend = robot(tmp_path, BASE + "", 4)
    units = {one.name: (one.unit, one.width) for one in backend.channels}
    assert units == {
        "q": ("rad", 4), "dq": ("rad/s", 4), "tau": ("N*m", 4), "target": ("", 4), "action": ("", 4),
        "x": ("m", 1), "y": ("m", 1), "z": ("m", 1), "height": ("m", 1), "vx": ("m/s", 1), "vy": ("m/s", 1),
        "vz": ("m/s", 1), "wz": ("rad/s", 1), "velocity": ("m/s", 3), "omega": ("rad/s", 3), "quaternion": ("", 4),
        "roll": ("rad", 1), "pitch": ("rad", 1), "yaw": ("rad", 1), "gravity": ("", 3), "obs": ("", 4),
        "gyro": ("rad/s", 3), "velocimeter": ("m/s", 3), "imu_attitude": ("", 4), "accelerometer": ("m/s^2", 3),
        "sensor_height": ("rad", 1),
    }  # fmt: skip
    found = backend.rollout({}, 3)
    assert {name: values.shape[1:] for name, values in found.channels.items()} == {
        name: () if width == 1 else (width,) for name, (_, width) in units.items()
    }
    assert found.units == {name: unit for name, (unit, _) in units.items()}
    assert {one.name: one.columns for one in backend.channels}["q"] == LEGS
    np.testing.assert_allclose(found["sensor_height"][1:], found["q"][:-1, 0], atol=1e-12)


@pytest.fixture
def arm(tmp_path, nothing_loaded):
    (tmp_path / "arm.xml").write_text(PARALLEL)
    (tmp_path / "control.py").write_text(ACT)
    head = 'model = "arm.xml"\npolicy = "control.py:act"\ndecimation = 2\nduration = 0.2\n'
    return opened(tmp_path, head)


def test_a_fixed_base_has_its_joints_and_sensors_alone(arm):
    """Slides and hinges apart; a sensor named like a channel, or like no channel, gets a prefix."""
    units = {one.name: (one.unit, one.width) for one in arm.channels}
    assert units == {
        "q": ("rad", 1), "dq": ("rad/s", 1), "tau": ("N*m", 1),
        "q_slide": ("m", 1), "dq_slide": ("m/s", 1), "tau_slide": ("N", 1), "ctrl": ("", 2),
        "lifted": ("m", 1), "turning": ("rad/s", 1), "turned": ("rad", 1), "tip": ("m", 3), "load_cell": ("N", 3),
        "sensor_5": ("N*m", 3), "sensor_q": ("N", 1), "sensor_1st": ("s", 1), "touch": ("N", 1), "effort": ("N", 1),
        "way": ("", 4),
    }  # fmt: skip


def test_slides_hinges_and_sensors_of_an_arm(tmp_path, arm):
    trace = arm.rollout({}, 0)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for tick in range(len(trace.times)):
        assert (trace["q_slide"][tick], trace["q"][tick]) == tuple(data.qpos[:2])
        assert np.array_equal(trace["tip"][tick], data.sensor("tip").data)
        data.ctrl[:] = 3.0, -0.25
        mujoco.mj_step(model, data, nstep=2)
    np.testing.assert_allclose(trace["tau_slide"], 3.0)
    np.testing.assert_allclose(trace["tau"], -0.25)
    np.testing.assert_allclose(trace["ctrl"], [[3.0, -0.25]] * len(trace.times))
    np.testing.assert_allclose(trace["sensor_q"][1:], 3.0)


def test_a_spec_reads_joints_and_sensors_in_other_units(tmp_path):
    backend = robot(tmp_path, BASE, 4)
    spec = s2r_spec.parse_spec(
        "signal q[4] {deg}\nsignal gyro[3] {deg/s}\nsignal height {cm}\n"
        "require r: always[0 s, 0.3 s] (q[2] <= 10 {deg} and gyro[1] <= 10 {deg/s} and height <= 1 {cm})\n"
        "certify r: fall = -1\n"
    )
    trace = backend.rollout({}, 3)
    scorer = Scorer.for_spec(spec, "r", backend.name)
    assert scorer.channels is not None
    wanted = min(
        (10 - np.degrees(trace["q"][:, 2])).min(), (10 - np.degrees(trace["gyro"][:, 1])).min(),
        (1 - 100 * trace["height"]).min(),
    )  # fmt: skip
    assert scorer.measure(trace, {}) == pytest.approx(wanted)


def test_sensors_of_any_name_have_channels_that_a_spec_can_name(tmp_path, nothing_loaded):
    """Other letters become _, a keyword of the language and a name that is taken get a prefix or a number."""
    names = ["a-b", "a.b", "a b", "sensor_q", "q", "always", "1st", "é", "ctrl"]
    sensors = "".join(f'<jointpos name="{name}" joint="turn"/>' for name in names)
    (tmp_path / "arm.xml").write_text(
        PARALLEL.replace("<sensor>", f"<sensor>{sensors}")
        .replace('1st"/><touch', '2nd"/><touch')
        .replace('name="q" actuator', 'name="p" actuator')
    )
    (tmp_path / "control.py").write_text(ACT)
    head = 'model = "arm.xml"\npolicy = "control.py:act"\ndecimation = 2\nduration = 0.2\nfailure.f = "a_b > 9"\n'
    backend = opened(tmp_path, head)
    channels = [one.name for one in backend.channels]
    assert len(set(channels)) == len(channels)
    wanted = ["a_b", "sensor_a_b", "sensor_a_b_2", "sensor_q", "sensor_q_2", "sensor_always", "sensor_1st"]
    assert [one for one in channels if one in wanted] == wanted
    trace = backend.rollout({}, 0)
    assert all(np.array_equal(trace[one], trace["a_b"]) for one in wanted)
    s2r_spec.parse_spec("".join(f"signal {one}\n" for one in channels) + "require r: a_b > 0\n")
