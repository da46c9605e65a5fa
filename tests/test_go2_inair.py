"""The simulator beside the real Go2 in the air; only where the recording and MuJoCo are at hand."""

from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from benchmarks.diagnose.go2_inair import CATALOGUE, GIVEN, SPEC, Go2InAir, recorded, segments
from s2r_spec.backend import Backend, HasDuration, HasEffects, HasResiduals
from s2r_spec.errors import TraceError, UsageError
from tests.errors import naming

pytest.importorskip("mujoco")
DATA = Path(__file__).parents[2] / "shared" / "data" / "go2_inair"
pytestmark = pytest.mark.skipif(not DATA.exists(), reason="the Go2 recording is not beside the checkout")
ROBOT = Go2InAir(DATA, duration=1.0)


def some(effect, part=0.5):
    return {p.name: p.nominal + part * (p.high - p.nominal) for p in effect.parameters}


def test_it_is_a_backend_with_effects_and_residuals():
    for protocol in (Backend, HasDuration, HasEffects, HasResiduals):
        assert isinstance(ROBOT, protocol)
    trace = ROBOT.rollout({"start": 3.0}, 0)
    assert dict(trace.units) == {channel.name: channel.unit for channel in ROBOT.channels}
    assert all(trace[channel.name].shape == (201, channel.width) for channel in ROBOT.channels)
    np.testing.assert_array_equal(trace["q_ref"], recorded(DATA)[0][600:801])
    with pytest.raises(UsageError, match=naming("start = 23 s", "[0, 22.485] s")):
        ROBOT.rollout({"start": 23.0}, 0)


def test_nominal_effects_change_no_bit_and_others_change_the_trace():
    nominal = {e.name: {p.name: p.nominal for p in e.parameters} for e in CATALOGUE}
    plain = ROBOT.rollout({"start": 3.0}, 0)
    assert np.array_equal(plain["q"], ROBOT.with_effects(nominal).rollout({"start": 3.0}, 0)["q"])
    for effect in CATALOGUE:
        worn = ROBOT.with_effects({effect.name: some(effect)})
        assert worn.model_hash != ROBOT.model_hash
        assert np.abs(worn.rollout({"start": 3.0}, 0)["q"] - plain["q"]).max() > 0.001


@pytest.mark.parametrize("name", ["armature", "viscous_friction", "friction"])
@pytest.mark.parametrize("joint", ["hip", "thigh", "calf"])
def test_what_one_kind_of_joint_has_shows_most_at_that_kind(name, joint):
    name, parameter = (f"{joint}_friction", "torque") if name == "friction" else (name, joint)
    effect = next(effect for effect in CATALOGUE if effect.name == name)
    worn = ROBOT.with_effects({name: {parameter: some(effect)[parameter]}})
    moved = np.abs(worn.rollout({"start": 3.0}, 0)["q"] - ROBOT.rollout({"start": 3.0}, 0)["q"]).mean(axis=0)
    by_kind = dict(zip(("hip", "thigh", "calf"), moved.reshape(4, 3).sum(axis=0), strict=True))
    assert max(by_kind, key=by_kind.get) == joint


def test_friction_differs_from_leg_to_leg_by_its_spread():
    def moved(legs):
        worn = ROBOT.with_effects({"calf_friction": {"torque": 0.8, **legs}})
        return np.abs(worn.rollout({"start": 3.0}, 0)["q"] - plain)[:, 2::3].mean(axis=0)

    plain = ROBOT.rollout({"start": 3.0}, 0)["q"]
    alike, more = moved({}), moved({"RL": 0.5})
    assert more[2] > 1.2 * alike[2]
    assert more[[0, 1, 3]] == pytest.approx(alike[[0, 1, 3]], rel=0.01)
    unmoved = ROBOT.with_effects({"calf_friction": {"torque": 0.0, "RL": 0.5}})
    assert np.array_equal(unmoved.rollout({"start": 3.0}, 0)["q"], plain)


@pytest.mark.parametrize(
    "name", ["armature", "viscous_friction", "motor_strength", "delay", "encoder_offset"]
)
def test_the_residual_torque_is_small_in_the_right_model_and_large_in_the_nominal_one(name):
    effect = next(effect for effect in CATALOGUE if effect.name == name)
    worn = ROBOT.with_effects({name: some(effect)})
    trace = worn.rollout({"start": 4.0}, 0)
    left, before = (np.sqrt(np.mean(robot.residuals(trace)["torque"] ** 2)) for robot in (worn, ROBOT))
    assert left < 0.25 * before
    with pytest.raises(TraceError, match=naming("q", "q_ref")):
        ROBOT.residuals(trace.only(["q"]))


def test_the_recording_in_segments_is_read_by_its_spec_and_nearer_to_joints_with_friction():
    spec, real = s2r.load_spec(SPEC), segments(DATA)
    assert len(real) == 11
    robot = Go2InAir(DATA)
    errors = []
    for model in (robot, robot.with_effects(GIVEN)):
        runs = [(model.rollout(params, 0), trace) for params, trace in real[1:8:3]]
        errors.append(np.mean([np.mean((run["q"] - trace["q"]) ** 2) for run, trace in runs]))
    assert errors[1] < 0.5 * errors[0]
    assert all(0 < spec.robustness(trace, params)["follows"] < 0.6 for params, trace in real)
