"""What a trace holds is what the robot's own sensors and loops had; motion capture sees the truth."""

import numpy as np
import pytest

from s2r_sim import SimBackend
from s2r_sim.controller.gains import Gains
from s2r_sim.effects import CATALOGUE
from s2r_sim.plant.channels import CHANNELS, FROM_OUTSIDE, TRUE_CHANNELS
from s2r_sim.plant.noise import Noise
from s2r_sim.settings import Settings

SHORT_WARM_UP = Settings(warm_up=0.2)
SHORT = SimBackend("record=truth", duration=0.2, settings=SHORT_WARM_UP)


def rollout(effects, backend=SHORT):
    return backend.with_effects(effects).rollout({"vd": 0.2}, 3)


def test_without_sensor_errors_what_is_measured_is_true():
    trace = rollout({"motor_strength": {"factor": 0.8}})
    for channel in TRUE_CHANNELS:
        np.testing.assert_array_equal(trace[channel.name], trace[channel.name.removesuffix("_true")])


def test_truth_is_recorded_on_demand_and_changes_nothing_else():
    effects = {"encoder_offset": {"thigh": 0.02}}
    measured, both = rollout(effects, SimBackend(duration=0.2, settings=SHORT_WARM_UP)), rollout(effects)
    assert list(measured.channels) == [channel.name for channel in CHANNELS]
    assert list(both.channels) == [channel.name for channel in SHORT.channels]
    assert SHORT.channels == CHANNELS + TRUE_CHANNELS
    assert {channel.name for channel in TRUE_CHANNELS} <= both.units.keys()
    for name, values in measured.channels.items():
        np.testing.assert_array_equal(values, both[name])


def test_encoders_report_their_offset():
    trace = rollout({"encoder_offset": {"hip": 0.01, "thigh": -0.02, "calf": 0.035}})
    offset = np.tile([0.01, -0.02, 0.035], 4)
    np.testing.assert_allclose(
        trace["q"] - trace["q_true"], np.broadcast_to(offset, (len(trace), 12)), atol=1e-15
    )
    np.testing.assert_array_equal(trace["dq"], trace["dq_true"])


def test_encoders_are_on_the_rotors_side_of_the_play():
    trace = rollout({"backlash": {"half_gap": 0.02}})
    play, rate = trace["q"] - trace["q_true"], trace["dq"] - trace["dq_true"]
    assert np.abs(play).max() == pytest.approx(0.02)
    # It touches both flanks and takes the way between them; on a flank it moves with the joint.
    assert play.min() == pytest.approx(-play.max())
    on_a_flank = np.abs(np.abs(play) - 0.02) < 1e-12
    assert 0.3 < on_a_flank.mean() < 1.0
    assert np.abs(rate[on_a_flank]).max() < 1e-12
    assert np.abs(rate[~on_a_flank]).max() > 0.5


def test_an_imu_that_is_askew_reports_its_own_attitude_and_heading_rate():
    trace = rollout({"attitude_bias": {"roll": 2.0, "pitch": -3.0}})
    np.testing.assert_allclose(trace["roll"] - trace["roll_true"], np.radians(2.0), atol=1e-15)
    np.testing.assert_allclose(trace["pitch"] - trace["pitch_true"], np.radians(-3.0), atol=1e-15)
    wx, wy, wz = trace["omega"].T
    for end in ("", "_true"):
        roll, pitch = trace[f"roll{end}"], trace[f"pitch{end}"]
        rate = np.cos(pitch) * (np.sin(roll) * wy + np.cos(roll) * wz) - np.sin(pitch) * wx
        np.testing.assert_allclose(trace[f"wz{end}"], rate, atol=1e-12)
    assert np.abs(trace["wz"] - trace["wz_true"]).max() > 1e-3


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"encoder_offset": {"hip": 0.02, "calf": -0.03}},
        {"backlash": {"half_gap": 0.01}},
        {"encoder_offset": {"thigh": 0.03}, "backlash": {"half_gap": 0.005}},
    ],
)
def test_motors_ask_for_what_their_law_makes_of_the_recorded_joints(effects):
    """The drives' currents are the law's torques at recorded angles and speeds: of a stance leg τ_ff − Kd q̇ or so."""
    trace = rollout(effects)
    kp = Gains().kp_joint_swing * (1.0 - np.repeat(trace["stance"], 3, axis=1))
    kd = Gains().kd_joint
    # What a drive makes in the last of the two steps of a tick, from the mean of both samples.
    q, dq, asked = trace["q"], trace["dq"], trace["tau_cmd"][:-1]
    law = asked - kp[:-1] * (q[1:] - q[:-1]) / 2 - kd * (dq[1:] - dq[:-1]) / 2
    left = np.abs(law - trace["tau"][:-1])
    # A flank that a rotor hits between two samples, and nothing else, stops it.
    assert np.quantile(left, 0.9) < 0.02
    true = asked - kp[:-1] * (trace["q_true"][1:] - q[:-1]) / 2 - kd * (trace["dq_true"][1:] - dq[:-1]) / 2
    if effects:
        assert np.quantile(np.abs(true - trace["tau"][:-1]), 0.9) > 0.05


def test_a_drive_reports_its_current_also_while_its_rotor_crosses_the_gap():
    trace = rollout({"backlash": {"half_gap": 0.02}})
    between = np.abs(trace["q"] - trace["q_true"]) < 0.015
    assert between.any()
    assert np.median(np.abs(trace["tau"][between])) > 0.1


DIRECTLY = {
    "velocity_bias": ({"forward": 0.1}, "vx_est"),
    "velocity_scale": ({"factor": 1.4}, "vx_est"),
    "attitude_bias": ({"roll": 3.0}, "roll"),
    "encoder_offset": ({"calf": 0.05}, "q"),
}


def test_every_sensing_effect_is_listed_here():
    assert DIRECTLY.keys() == {name for name, effect in CATALOGUE.items() if effect.family == "sensing"}


@pytest.mark.parametrize("effect", DIRECTLY)
def test_a_sensing_effect_shows_in_a_recorded_channel_from_the_first_sample_on(effect):
    values, channel = DIRECTLY[effect]
    quiet = SimBackend("record=truth", duration=0.2, noise=Noise.off(), settings=SHORT_WARM_UP)
    trace = rollout({effect: values}, quiet)
    said, true = {
        "vx_est": lambda: (trace["vx_est"], trace["vx"]),
        "roll": lambda: (trace["roll"], trace["roll_true"]),
        "q": lambda: (trace["q"][:, 2], trace["q_true"][:, 2]),
    }[channel]()
    expected = {
        "velocity_bias": 0.1,
        "velocity_scale": 0.4 * true.mean(),
        "attitude_bias": np.radians(3.0),
        "encoder_offset": 0.05,
    }[effect]
    assert (said - true).mean() == pytest.approx(expected, rel=0.25, abs=2e-3)
    if effect != "velocity_scale":
        assert said[0] - true[0] == pytest.approx(expected, rel=0.3)


@pytest.mark.parametrize("effect", DIRECTLY)
def test_what_is_seen_from_outside_has_no_error_of_the_robots_sensors(effect):
    """Kinematics of the true joints lead from the base to where motion capture sees the feet."""
    values, _ = DIRECTLY[effect]
    machine = SHORT.with_effects({effect: values})
    trace = machine.rollout({"vd": 0.2}, 3)
    assert np.abs(machine.residuals(trace, {"vd": 0.2})["foot_place"]).max() < 1e-5
    assert all(np.isfinite(trace[name]).all() for name in FROM_OUTSIDE)


def test_an_offset_written_as_a_robot_writes_it_is_known():
    """Residuals that reckon with the offset leave what the nominal ones leave without any."""
    offset = {"encoder_offset": {"thigh": 0.03}}
    quiet = SimBackend(duration=0.3, settings=SHORT_WARM_UP)
    trace, usual = rollout(offset, quiet), rollout({}, quiet)
    bare = quiet.residuals(trace, {"vd": 0.2})
    known = quiet.with_effects(offset).residuals(trace, {"vd": 0.2})
    nominal = quiet.residuals(usual, {"vd": 0.2})
    for name in ("foot_place", "base_torque", "joint_torque"):
        left, at_first, least = (np.abs(found[name]).mean() for found in (known, bare, nominal))
        assert at_first > 3 * least, name
        assert left < 1.5 * least, name
