"""The axis: what it declares, what its seed and its parameters fix, and the controller that it runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_emps import EmpsBackend
from s2r_emps.noise import Noise
from s2r_emps.physics import GAIN, KP, KV, Physics
from s2r_spec.backend import Backend, HasDuration, HasEffects, HasResiduals
from s2r_spec.errors import UsageError
from tests.errors import naming

ROOT = Path(__file__).parents[2]
AXIS = EmpsBackend()
QUIET = EmpsBackend(noise=Noise.off())


def test_it_is_found_by_name_and_is_all_that_it_says():
    assert s2r.load_backend("emps") == AXIS
    for protocol in (Backend, HasDuration, HasEffects, HasResiduals):
        assert isinstance(AXIS, protocol)


def test_the_channels_are_as_declared():
    trace = AXIS.rollout({"speed": 0.1}, seed=3)
    assert dict(trace.units) == {channel.name: channel.unit for channel in AXIS.channels}
    assert len(trace) == 2501
    assert trace.duration == pytest.approx(2.5)
    np.testing.assert_array_equal(trace["force"], GAIN * trace["u"])


def test_parameters_and_seed_fix_the_trace():
    one, same, other = (AXIS.rollout({"payload": 5.0}, seed)["q"].tobytes() for seed in (5, 5, 6))
    assert one == same != other


def test_a_shorter_rollout_is_the_beginning_of_a_longer_one():
    short = AXIS.with_duration(1.0).rollout({}, seed=1)
    assert np.array_equal(short["q"], AXIS.rollout({}, seed=1)["q"][: len(short)])
    assert AXIS.model_hash != replace(AXIS, physics=Physics(mass=96.0)).model_hash


def test_the_nominal_axis_is_a_double_integrator_under_the_cascade():
    """Held to the discrete closed loop in state space, stepped by matrices."""
    trace = QUIET.rollout({"payload": 10.0}, seed=0)
    h, per_mass = 1e-3, GAIN / (Physics.mass + 10.0)
    # state: position, speed, position one tick ago
    a = np.array([[1, h, 0], [0, 1, 0], [1, 0, 0]])
    b = np.array([h * h / 2, h, 0]) * per_mass
    feedback = KV * np.array([-KP - 1 / h, 0, 1 / h])
    state = np.array([trace["q_ref"][0], 0, trace["q_ref"][0]])
    for k, asked in enumerate(trace["q_ref"]):
        u = feedback @ state + KV * KP * asked
        assert trace["q"][k] == pytest.approx(state[0], abs=1e-12)
        assert trace["u"][k] == pytest.approx(u, abs=1e-8)
        state = a @ state + b * u


def test_the_following_error_of_a_cruise_is_that_of_the_position_gain():
    trace = QUIET.rollout({"speed": 0.1, "accel": 2.0}, seed=0)
    cruising = (trace.times > 0.5) & (trace.times < 1.0)
    error = (trace["q_ref"] - trace["q"])[cruising]
    assert error == pytest.approx(0.1 / KP, rel=1e-3)


def test_the_move_goes_out_and_back_within_its_speed_and_acceleration():
    trace = AXIS.rollout({"stroke": -0.12, "speed": 0.2, "accel": 1.5, "pause": 0.1}, seed=0)
    asked = trace["q_ref"]
    assert asked.max() == pytest.approx(0.18)
    assert asked.min() == pytest.approx(0.06)
    assert asked[-1] == pytest.approx(asked[0])
    speed = np.diff(asked) / 1e-3
    assert np.abs(speed).max() == pytest.approx(0.2, rel=1e-6)
    assert np.abs(np.diff(speed) / 1e-3).max() == pytest.approx(1.5, rel=1e-3)


def test_a_move_too_short_for_its_speed_stays_within_its_acceleration():
    trace = AXIS.rollout({"stroke": 0.02, "speed": 0.3, "accel": 1.0}, seed=0)
    speed = np.diff(trace["q_ref"]) / 1e-3
    assert np.ptp(trace["q_ref"]) == pytest.approx(0.02)
    assert np.abs(np.diff(speed) / 1e-3).max() == pytest.approx(1.0, rel=1e-3)


def test_without_friction_a_coasting_carriage_keeps_its_speed():
    trace = QUIET.rollout({"coast": 0.2}, seed=0)
    off = trace["u"] == 0
    off[:200] = False
    assert off.sum() == 200
    assert np.ptp(trace["v"][off]) < 1e-9
    slowed = QUIET.with_effects({"coulomb": {"force": 19.0}}).rollout({"coast": 0.2}, seed=0)
    assert slowed["v"][off][-1] - slowed["v"][off][1] == pytest.approx(-19.0 / 95.0 * 0.198, rel=1e-6)


@pytest.mark.parametrize(
    ("params", "facts"),
    [
        ({"speed": 3.0}, ["speed = 3 m/s", "[0.01, 0.3] m/s"]),
        (
            {"sped": 0.1},
            ["'emps'", "'sped'", "did you mean 'speed'", "accel, coast"],
        ),
    ],
)
def test_a_bad_test_gets_a_sentence(params, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        AXIS.rollout(params, seed=0)


def test_a_rollout_takes_milliseconds():
    import time

    worn = AXIS.with_effects({"coulomb": {"force": 20.0}, "viscous": {"coefficient": 200.0}})
    worn.rollout({}, 0)
    begin = time.process_time()
    for seed in range(5):
        worn.rollout({}, seed)
    assert (time.process_time() - begin) / 5 < 0.1  # measured 0.008 s; the bound is for busy machines


def test_the_spec_is_met_by_the_nominal_axis_over_its_test_space():
    spec = s2r.load_spec(ROOT / "specs" / "emps_tracking.stl")
    for vector in spec.space.grid((2, 2, 2)):
        test = spec.space.point(vector)
        rho = spec.robustness(AXIS.rollout(test, 0), test)["tracks"]
        trace = AXIS.rollout(test, 0)
        assert rho == pytest.approx(2e-3 - np.abs(trace["q"] - trace["q_ref"]).max(), abs=1e-15)
        assert 1e-4 < rho < 2e-3
