from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.errors import UsageError
from s2r_turtlebot import Constants, TurtlebotBackend, steer
from tests.errors import naming

ROOT = Path(__file__).parents[2]
SPEC = ROOT / "specs" / "turtlebot.stl"
ROBOT = TurtlebotBackend()
CONSTANTS = Constants()


def test_with_the_obstacle_out_of_the_way_it_drives_straight_to_the_goal():
    trace = ROBOT.rollout({"ox": 0.0, "oy": 1.0}, seed=0)
    assert trace["d_goal"][-1] < 0.1
    assert np.abs(trace["y"]).max() < 0.1


@pytest.mark.parametrize("oy", [0.0, 0.1, 0.3, -0.2])
@pytest.mark.parametrize("ox", [-0.3, 0.0, 0.3])
def test_it_keeps_its_distance_and_arrives_all_the_same(ox, oy):
    for seed in range(3):
        trace = ROBOT.rollout({"ox": ox, "oy": oy}, seed)
        assert trace["d_obs"].min() > 0.25
        assert trace["d_goal"][-1] < 0.1


def test_without_slip_left_and_right_are_mirror_images():
    ideal = replace(ROBOT, constants=replace(CONSTANTS, slip=0.0))
    left, right = (ideal.rollout({"ox": 0.1, "oy": oy}, seed=0) for oy in (0.2, -0.2))
    assert np.allclose(left["y"], -right["y"], atol=1e-12)
    assert np.allclose(left["d_obs"], right["d_obs"], atol=1e-12)


def test_the_filter_is_the_nearest_velocity_that_satisfies_the_barrier():
    """Held to the definition: feasible, and no random feasible velocity is nearer to what was wanted."""
    rng = np.random.default_rng(0)
    free = replace(CONSTANTS, keep=1e-6, swirl=0.0)
    for _ in range(50):
        x, y, ox, oy = rng.uniform(-0.5, 0.5, 4)
        away = np.array([x - ox, y - oy])
        least = -CONSTANTS.decay * (away @ away - CONSTANTS.keep**2)
        chosen = np.array(steer(x, y, ox, oy, replace(CONSTANTS, swirl=0.0)))
        wanted = np.array(steer(x, y, 9.0, 9.0, free))
        assert 2 * away @ chosen >= least - 1e-9
        others = chosen + rng.normal(scale=0.1, size=(500, 2))
        others = others[2 * others @ away >= least]
        assert (np.linalg.norm(others - wanted, axis=1) >= np.linalg.norm(chosen - wanted) - 1e-9).all()


def test_the_channels_are_as_declared_and_agree_with_each_other():
    trace = ROBOT.rollout({"ox": 0.2, "oy": 0.1}, seed=3)
    assert dict(trace.units) == {channel.name: channel.unit for channel in ROBOT.channels}
    assert len(trace) == 401
    assert trace.duration == pytest.approx(8)
    assert np.allclose(trace["d_obs"], np.hypot(trace["x"] - 0.2, trace["y"] - 0.1))
    assert np.allclose(trace["d_goal"], np.hypot(trace["x"] - 0.8, trace["y"]))


def test_parameters_and_seed_fix_the_trace():
    one, same, other = (ROBOT.rollout({"ox": 0.1, "oy": 0.2}, seed)["x"].tobytes() for seed in (5, 5, 6))
    assert one == same != other


def test_a_shorter_rollout_is_the_beginning_of_a_longer_one_and_another_model_has_another_hash():
    short = ROBOT.with_duration(1.0).rollout({}, seed=1)
    assert np.array_equal(short["y"], ROBOT.rollout({}, seed=1)["y"][: len(short)])
    assert short.duration == pytest.approx(1)
    assert ROBOT.model_hash != replace(ROBOT, constants=Constants(speed=0.5)).model_hash


def test_an_obstacle_outside_the_range_gets_a_sentence():
    with pytest.raises(UsageError, match=naming("ox = 0.5 m", "[-0.4, 0.4] m")):
        ROBOT.rollout({"ox": 0.5}, seed=0)


@pytest.mark.parametrize("name", ["oz", "Ox", "radius"])
def test_a_parameter_that_it_does_not_have_is_refused(name):
    with pytest.raises(UsageError, match=rf"{name}.*ox, oy"):
        ROBOT.rollout({"oy": 0.5, name: 0.1}, seed=0)


def test_s2r_check_from_end_to_end(tmp_path):
    spec = s2r.load_spec(SPEC)
    result = s2r.check(spec, "turtlebot", tmp_path / "run", budget=150, stop="epsilon")
    assert result.certificate.label is s2r.Label.BUDGET
    assert result.lower <= 0.097 <= result.upper  # the worst mean ρ of `s2r pilot`
    assert set(result.worst.params) == {"ox", "oy"}
    again = s2r.load_backend("turtlebot").rollout(result.lowest.params, result.lowest.seed)
    assert spec.robustness(again, result.lowest.params)["delivers"] == result.lowest.rho


def test_the_tutorial_plug_in_stays_short():
    folder = ROOT / "backends" / "s2r_turtlebot"
    assert {path.name for path in folder.rglob("*.py")} == {"__init__.py", "effects.py"}
    assert (folder / "__init__.py").read_text().count("\n") <= 150
    assert "effects import" not in (folder / "__init__.py").read_text()  # complete without them
