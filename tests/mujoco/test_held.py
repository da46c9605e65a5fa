"""Joint logs without a task: a held robot's protocols, replayed commands, residuals, and what a log is good for."""

import csv

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.backend import load_backend
from s2r_spec.conformance import check_conformance
from s2r_spec.diagnose.before import Identified, before_data
from s2r_spec.errors import TraceError, TraceNote, UsageError
from s2r_spec.protocols import PLAYED, PROTOCOL, HasInputs, HasPlayable, HasProtocols, write_playable
from s2r_spec.trace import Trace
from tests.errors import naming
from tests.mujoco.make_policies import HERE
from tests.mujoco.robots import SPIN, opened, robot
from tests.mujoco.test_cart import STATE
from tests.mujoco.test_found import deployed

ARM = """<mujoco model="arm">
  <compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
  <worldbody>{base}
    <body name="left_upper" pos="0 0.2 0"><joint name="left_shoulder" axis="0 1 0" range="-2 2" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/>
      <body name="left_lower" pos="0 0 -0.3"><joint name="left_elbow" axis="0 1 0" range="-2 1" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.5"/></body></body>
    <body name="right_upper" pos="0 -0.2 0"><joint name="right_shoulder" axis="0 1 0" range="-2 2" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/>
      <body name="right_lower" pos="0 0 -0.3"><joint name="right_elbow" axis="0 1 0" range="-2 1" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.5"/></body></body>
  {end}</worldbody>
  <actuator>
    <motor joint="right_elbow" forcerange="-10 10"/><motor joint="right_shoulder" forcerange="-20 20"/>
    <motor joint="left_elbow" forcerange="-10 10"/><motor joint="left_shoulder" forcerange="-20 20"/>
  </actuator>
</mujoco>"""
"""Two arms of two links, whose motors have another order than their joints."""
FREE = """<geom type="plane" size="0 0 1"/>
  <body name="trunk" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.1"/>"""
TOML = """
model = "arm.xml"
decimation = 2
[action]
stiffness = { ".*_shoulder" = 40, ".*_elbow" = 20 }
damping = { ".*_shoulder" = 3, ".*_elbow" = 1.5 }
"""
NAMES = ["left_shoulder", "left_elbow", "right_shoulder", "right_elbow"]


def arm(folder, free=False, toml=TOML):
    base, end = (FREE, "</body>") if free else ("", "")
    (folder / "arm.xml").write_text(ARM.format(base=base, end=end))
    (folder / "robot.toml").write_text(toml)
    return load_backend(str(folder / "robot.toml"))


def rms(residuals):
    """Return the rms of every joint's residual."""
    return np.sqrt([(values**2).mean() for values in residuals.channels.values()])


@pytest.fixture
def arms(tmp_path):
    return arm(tmp_path)


def test_a_robot_file_without_a_policy_offers_protocols_within_the_ranges_of_its_joints(arms):
    assert isinstance(arms, HasProtocols)
    assert isinstance(arms, HasPlayable)
    assert isinstance(arms, HasInputs)
    assert [one.name for one in arms.protocols()] == ["joint_sine", "steps", "hold", "coast"]
    low, high = np.array([-2, -2, -2, -2]), np.array([2, 1, 2, 1])
    for one in arms.protocols():
        trace = arms.run(one.name, {}, 0)
        assert trace.meta[PROTOCOL] == one.name
        assert trace.duration == pytest.approx(one.duration)
        assert trace.failure is None
        assert (trace["target"] > low).all()
        assert (trace["target"] < high).all()
        assert (np.ptp(trace["q"], axis=0) > 0.2).all()
        assert (np.abs(trace["tau"]) <= [20, 10, 20, 10]).all()
    assert np.allclose(arms.rollout({}, 0)["target"], 0.0)  # without a controller the default pose is held
    with pytest.raises(UsageError, match=naming("amplitude", "[0.25, 1]")):
        arms.run("steps", {"amplitude": 3.0}, 0)


def test_motors_are_off_while_a_robot_coasts(arms):
    trace = arms.run("coast", {}, 0)
    off = trace.times >= 0.5
    assert np.all(trace["tau"][off] == 0.0)
    assert np.abs(trace["tau"][~off][1:]).min(axis=0).max() > 0.1


def test_the_references_are_a_file_for_the_robots_own_player(arms, tmp_path):
    words = write_playable(arms, "coast", {"amplitude": 0.5}, tmp_path / "coast.csv")
    assert "stops" in words
    with (tmp_path / "coast.csv").open() as stream:
        header, *rows = [row for row in csv.reader(stream) if not row[0].startswith("#")]
    names = [word.split(" ")[0] for word in header]
    assert names[1:5] == ["q_0", "q_1", "q_2", "q_3"]
    columns = dict(zip(names, np.array(rows, dtype=float).T, strict=True))
    trace = arms.run("coast", {"amplitude": 0.5}, 0)
    assert np.allclose(columns["q_2"], trace["target"][:, 2])
    assert columns["kp_0"][0] == 40.0
    assert columns["kp_1"][0] == 20.0
    assert columns["kp_0"][-1] == columns["kd_0"][-1] == 0.0


def test_a_robot_with_a_free_base_is_held(tmp_path, arms):
    fixed = {one: arms.run(one, {}, 0)["q"] for one in ("joint_sine", "coast")}
    free = arm(tmp_path, free=True)
    for one, q in fixed.items():
        trace = free.run(one, {}, 0)
        assert "z" not in trace.channels
        assert np.allclose(trace["q"], q, atol=1e-9)


def test_a_robot_with_a_policy_offers_protocols_too(tmp_path):
    box = robot(
        tmp_path,
        'decimation = 4\nobservation = ["joint_pos_rel"]\naction = { scale = 0.1, stiffness = 3, damping = 0.08 }\n',
        4,
    )
    trace = box.with_effects({"dry_friction": {"joint": 0.1}, "slope": {"forward": 3.0}}).run(
        "joint_sine", {}, 0
    )
    assert trace["q"].shape[1] == 4
    assert rms(box.residuals(trace)).min() > 0.05
    with pytest.raises(TraceError, match="contacts"):
        box.residuals(box.rollout({}, 0))


def with_keys_of_tests(folder):
    text = 'decimation = 4\nobservation = ["base_lin_vel", { term = "projected_gravity", frame = "imu" }]\n'
    text += 'root = "trunk"\nfailure.fell = "height < 0.1"\naction = { stiffness = 3, damping = 0.08 }\n'
    return robot(folder, text + SPIN + "effects.slope.left = 2.0\neffects.armature.joint = 0.01\n", 6)


def with_gains_of_metadata(folder):
    for name in ("cart.xml", "cart_mjlab.onnx"):
        (folder / name).write_bytes((HERE / name).read_bytes())
    return opened(folder, f'model = "cart.xml"\npolicy = "cart_mjlab.onnx"\ndecimation = 4\n{STATE}')


@pytest.mark.parametrize("made", [deployed, with_keys_of_tests, with_gains_of_metadata])
def test_what_only_a_policy_or_a_free_base_needs_stops_no_protocol_log_or_residual(tmp_path, made):
    backend = made(tmp_path)
    trace = backend.run("steps", {}, 0)
    log = trace.between(1.0, 3.0).shift(-1.0)
    played = backend.play(log, {}, 0)
    name = "q_slide" if "q_slide" in log.channels else "q"
    assert np.ptp(log[name]) > 0.1
    assert played[name] == pytest.approx(log[name], abs=0.03)
    assert rms(backend.residuals(trace)).max() < 0.1


@pytest.mark.parametrize("protocol", ["joint_sine", "steps", "coast"])
@pytest.mark.parametrize(
    "effects",
    [
        {"dry_friction": {"elbow": 0.4, "elbow_left": 0.5}},
        {"viscous_friction": {"shoulder": 0.3}},
        {"armature": {"elbow": 0.02}},
        {"encoder_offset": {"shoulder": 0.1}},
    ],
)
def test_residuals_are_what_the_model_lacks(arms, protocol, effects):
    worn = arms.with_effects(effects)
    trace = worn.run(protocol, {}, 0)
    before, left = (rms(one.residuals(trace)) for one in (arms, worn))
    assert (left / before).min() < 0.35
    assert left.max() < 1.1 * before.max()
    assert list(arms.residuals(trace).meta["parts"].values()) == [[name] for name in NAMES]


@pytest.mark.parametrize(
    "effects",
    [
        {"kp": {"shoulder": 0.8}},
        {"kd": {"elbow": 0.6}},
        {"motor_strength": {"shoulder": 0.8}},
        {"action_delay": {"time": 0.015}},
        {"actuator_lag": {"time": 0.015}},
    ],
)
def test_residuals_know_the_motors(arms, effects):
    worn = arms.with_effects(effects)
    trace = worn.run("joint_sine", {"rate": 5.0}, 0)
    before, left = (rms(one.residuals(trace)) for one in (arms, worn))
    assert (left / before).min() < 0.35
    assert left.max() < 1.1 * before.max()


def test_residuals_turn_gravity_with_the_base_and_take_logged_torques(arms):
    trace = arms.run("hold", {}, 0)
    torques = trace.only(["q", "tau"])
    assert rms(arms.residuals(torques)).max() < 0.1
    upside = np.tile([0.0, 1.0, 0.0, 0.0], (len(trace), 1))
    turned = Trace(trace.times, {**torques.channels, "quaternion": upside}, torques.units, trace.meta)
    assert rms(arms.residuals(turned)).max() > 1.0
    with pytest.raises(TraceError, match=naming("target", "tau")):
        arms.residuals(trace.only(["q"]))


def test_the_friction_of_one_joint_exceeds_that_of_its_kind(arms):
    alike = arms.with_effects({"dry_friction": {"elbow": 0.4}})
    more = arms.with_effects({"dry_friction": {"elbow": 0.4, "elbow_left": 0.5}})
    alone = arms.with_effects({"dry_friction": {"elbow_left": 0.5}})
    moved = np.abs(more.run("joint_sine", {}, 0)["q"] - alike.run("joint_sine", {}, 0)["q"]).max(axis=0)
    assert moved[1] > 0.005
    assert moved[2:].max() == 0.0
    assert np.array_equal(alone.run("joint_sine", {}, 0)["q"], arms.run("joint_sine", {}, 0)["q"])


def test_a_log_is_played_from_its_own_state(arms):
    log = arms.run("joint_sine", {}, 0).between(3.0, 6.0).shift(-3.0)
    played = arms.play(log.only(["q", "target"]), {}, 0)
    assert played.meta[PROTOCOL] == PLAYED
    assert np.array_equal(played["target"], log["target"])
    assert np.abs(played["q"] - log["q"]).max() < 0.01
    worn = arms.with_effects({"dry_friction": {"elbow": 0.6}}).play(log, {}, 0)
    assert np.abs(worn["q"] - log["q"]).max() > 0.02
    with pytest.raises(TraceError, match="target"):
        arms.play(log.only(["q"]), {}, 0)
    with pytest.raises(TraceError, match=naming("q", "4")):
        arms.play(Trace(log.times, {"q": log["q"][:, :2], "target": log["target"]}, {}), {}, 0)


def late(trace, seconds):
    rows = round(seconds / (trace.times[1] - trace.times[0]))
    return Trace(
        trace.times[rows:] - trace.times[rows],
        {"q": trace["q"][:-rows], "target": trace["target"][rows:]},
        {},
        trace.meta,
    )


def save(trace, path):
    """Write positions and targets, as a logger does that knows no protocol."""
    s2r.write_trace(Trace(trace.times, {name: trace[name] for name in ("q", "target")}, {}), path)


def words(backend, trace):
    return [(one.words, one.certain) for one in backend.loop(trace)]


def test_a_log_that_is_slow_late_or_still_is_named(arms):
    worn = arms.with_effects({"action_delay": {"time": 0.02}, "dry_friction": {"elbow": 0.5}})
    log = worn.run("joint_sine", {}, 0)
    assert not words(arms, log)
    ((slow, certain),) = words(arms, log.resample(1.0 / 15.0))
    assert certain
    assert "15" in slow
    ((behind, certain),) = words(arms, late(log, 0.5))
    assert certain
    assert 450.0 < float(behind.partition(" ms")[0].split()[-1]) < 550.0
    still = log.with_channels(lambda name, x: np.where(np.arange(4) == 1, x[0], x) if name == "q" else x)
    assert [(NAMES[1] in text, certain) for text, certain in words(arms, still)] == [(True, False)]


PENDULUM = """<mujoco model="pendulum">
  <compiler angle="radian"/><option timestep="0.005" integrator="implicitfast"/>
  <worldbody><body name="link"><joint name="swing" axis="0 1 0" range="-2 2" armature="0.02"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/></body></worldbody>
  <actuator><motor joint="swing" forcerange="-20 20"/></actuator>
</mujoco>"""
SPEC = """
signal q {rad}
signal target {rad}
param start {s} in [0, 9]
const tol = 1 {rad}
require follows: always[0, 1 s] (abs(q - target) <= tol)
"""


@pytest.fixture
def pendulum(tmp_path):
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    action = "[action]\nstiffness = 40\ndamping = 3\n"
    (tmp_path / "robot.toml").write_text(f'model = "pendulum.xml"\ndecimation = 2\n{action}')
    return load_backend(str(tmp_path / "robot.toml"))


def test_a_diagnosis_replays_the_commands_of_one_long_log(pendulum, tmp_path):
    worn = pendulum.with_effects({"dry_friction": {"swing": 1.2}})
    (tmp_path / "logs").mkdir()
    save(worn.run("joint_sine", {}, 3), tmp_path / "logs" / "long.npz")
    with pytest.warns(TraceNote, match="10 parts of 1 s"):
        real = load_backend(f"log:{tmp_path / 'logs'}?every=1")
    assert sorted(one.params["start"] for one in real.recordings) == pytest.approx(list(range(10)), abs=1e-6)
    spec = s2r.parse_spec(SPEC)
    found = s2r.diagnose(
        spec, pendulum, real, budget=7, open_loop=True, passive=True, where=False, cache=tmp_path / "cache"
    )
    answer = found.to_json()["which"]
    assert [name for name, status in answer["status"].items() if status == "named"] == ["dry_friction"]
    size = answer["parameters"]["dry_friction"]["swing"]
    assert size["low"] < 1.2 < size["high"]
    with pytest.raises(UsageError, match="recordings"):
        s2r.diagnose(spec, pendulum, pendulum, open_loop=True)


def test_torques_drive_the_joints_where_a_log_has_no_targets(pendulum, tmp_path):
    times = np.arange(701) / 100
    torque = 0.8 * np.sin(2 * np.pi * (0.4 * times + 0.04 * times**2))
    sent = Trace(times, {"q": 0 * times, "dq": 0 * times, "tau": torque}, {})
    runs = {}
    for size in (0.0, 0.016):
        trace = pendulum.with_effects({"armature": {"swing": size}}).play(sent, {}, 0)
        assert np.allclose(trace["tau"].ravel(), torque)
        parts = [trace.between(k, k + 1.0) for k in range(7)]
        runs[size] = [
            ({"start": float(k)}, Trace(part.times - k, {name: part[name] for name in ("q", "tau")}, {}))
            for k, part in enumerate(parts)
        ]
    log = Trace(times, {name: pendulum.play(sent, {}, 0)[name] for name in ("q", "dq", "tau")}, {})
    assert np.allclose(pendulum.play(log, {}, 0)["q"], log["q"], atol=1e-6)
    spec = s2r.parse_spec(
        SPEC.replace("signal target {rad}\n", "").replace("q - target", "q").replace("1 {rad}", "2 {rad}")
    )
    answer = s2r.diagnose(
        spec, pendulum, runs[0.016], open_loop=True, passive=True, where=False, cache=tmp_path / "cache"
    )
    (named,) = (one for one in answer.which.effects if one.status.value == "named")
    assert named.effect == "armature"
    assert named.largest.low < 0.016 < named.largest.high
    assert any("torques drive" in note for note in answer.notes)
    with pytest.raises(TraceError, match="tau"):
        pendulum.play(log.only(["q"]), {}, 0)


def test_a_log_with_a_wrong_clock_is_reported_and_not_fitted(pendulum, tmp_path):
    log = late(pendulum.run("joint_sine", {}, 3), 0.5)
    (tmp_path / "logs").mkdir()
    save(log, tmp_path / "logs" / "long.npz")
    with pytest.warns(TraceNote, match="9 parts of 1 s"):
        real = load_backend(f"log:{tmp_path / 'logs'}?every=1")
    found = s2r.diagnose(s2r.parse_spec(SPEC), pendulum, real, open_loop=True, cache=tmp_path / "cache")
    answer = found.to_json()
    assert not answer["which"]["parameters"]
    assert any("late" in note for note in answer["notes"])


def test_before_the_data_its_protocols_identify_the_joint_and_hold_alone_does_not(
    pendulum, tmp_path, monkeypatch
):
    monkeypatch.setenv("S2R_CACHE", str(tmp_path / "cache"))
    every, hold = (
        {
            one.axis.effect: one.status
            for one in before_data(s2r.parse_spec(SPEC), pendulum, protocols=names, open_loop=True).effects
        }
        for names in (None, ["hold"])
    )
    known = ("dry_friction", "viscous_friction", "armature", "kp", "kd", "encoder_offset")
    assert {every[name] for name in known} == {Identified.ALONE}
    assert hold["viscous_friction"] is not Identified.ALONE


def test_the_backend_conforms(arms):
    report = check_conformance(arms)
    assert not [one for one in report if "protocol" in str(one) and "wrong" in str(one)]
