"""Effects: they compose in any order, do nothing at nominal, and do their physics otherwise."""

import random
from functools import cache

import numpy as np
import pytest

from s2r_sim import SimBackend
from s2r_sim.effects import CATALOGUE, with_effects
from s2r_sim.plant.noise import Noise
from s2r_sim.plant.physics import USUAL_LOAD, Physics
from s2r_sim.robot.constants import A1
from s2r_sim.settings import Settings
from s2r_spec.backend import HasEffects
from s2r_spec.effects import choose
from s2r_spec.errors import UsageError
from tests.errors import naming

SHORT_WARM_UP = Settings(warm_up=0.2)
"""Every effect makes a world of its own, which is warmed up first: by default for a second."""
SHORT = SimBackend(duration=0.2, settings=SHORT_WARM_UP)
QUIET = SimBackend(duration=1.6, noise=Noise.off(), settings=SHORT_WARM_UP)
FAMILIES = {"actuation", "sensing", "contact", "terrain", "inertia", "timing"}


def between(effect, part):
    """Return values on the way from nominal to the end of the range that is farther away."""
    return {
        p.name: p.nominal + part * (max(p.low, p.high, key=lambda end: abs(end - p.nominal)) - p.nominal)
        for p in effect.parameters
    }


def nominal(effect):
    return {p.name: p.nominal for p in effect.parameters}


def same(a, b):
    return all(a[name].tobytes() == b[name].tobytes() for name in a.channels)


@cache
def unchanged(vd=0.0):
    """Return a rollout of the quiet robot without any effect."""
    return QUIET.rollout({"vd": vd}, 0)


@cache
def short():
    """Return a short rollout without any effect."""
    return SHORT.rollout({"vd": 0.3}, 4)


def steady(trace):
    return (trace.times >= 0.8) & (trace.times < 1.6)


def test_the_backend_offers_the_catalogue():
    assert isinstance(SHORT, HasEffects)
    assert len(SHORT.effects()) == 21
    for effect in SHORT.effects():
        assert CATALOGUE[effect.name] is effect
        assert effect.family in FAMILIES
        assert effect.physics.endswith(".")
        for p in effect.parameters:
            assert p.low <= p.nominal <= p.high
            assert p.prior


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=lambda effect: effect.name)
def test_at_nominal_the_world_is_unchanged(effect):
    assert effect.apply(Physics(), **nominal(effect)) == Physics()


def test_all_effects_at_nominal_change_no_bit():
    added = SHORT.with_effects({effect.name: nominal(effect) for effect in SHORT.effects()})
    assert same(short(), added.rollout({"vd": 0.3}, 4))
    assert added.model_hash == SHORT.model_hash


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=lambda effect: effect.name)
def test_every_effect_changes_the_trace_and_the_hash(effect):
    added = SHORT.with_effects({effect.name: between(effect, 0.9)})
    assert added.model_hash != SHORT.model_hash
    assert not same(short(), added.rollout({"vd": 0.3}, 4))


@pytest.mark.parametrize("seed", range(5))
def test_effects_applied_in_any_order_make_the_same_world(seed):
    effects = list(CATALOGUE.values())
    worlds = []
    for _ in range(2):
        random.Random(seed).shuffle(effects)
        physics = Physics()
        for effect in effects:
            physics = effect.apply(physics, **between(effect, 0.3))
        worlds.append(physics)
        effects.reverse()
    assert worlds[0] == worlds[1]


def test_adding_one_by_one_is_adding_at_once():
    one = SHORT.with_effects({"latency": {"delay": 0.004}}).with_effects({"slope": {"angle": 2.0}})
    both = SHORT.with_effects({"slope": {"angle": 2.0}, "latency": {"delay": 0.004}})
    assert one == both
    assert same(one.rollout({}, 1), both.rollout({}, 1))


def test_a_value_given_later_replaces_the_earlier_one():
    later = SHORT.with_effects({"payload": {"mass": 1.0, "x": 0.1}}).with_effects({"payload": {"mass": 2.0}})
    assert later.added == (("payload", (("mass", 2.0), ("x", 0.1))),)


def test_effects_are_in_the_meta():
    trace = SHORT.with_effects({"latency": {"delay": 0.004}}).rollout({}, 0)
    assert trace.meta["effects"] == {"latency": {"delay": 0.004}}


@pytest.mark.parametrize(
    ("values", "facts"),
    [
        (
            {"latncy": {}},
            ["'latncy'", "did you mean 'latency'", "armature", "viscous_friction"],
        ),
        ({"payload": {"m": 1.0}}, ["'payload'", "'m'", "mass, x, y, z"]),
        ({"latency": {"delay": 1.0}}, ["latency", "delay = 1 s", "[0, 0.03] s"]),
        ({"slope": {"angle": float("nan")}}, ["slope", "angle = nan deg"]),
    ],
)
def test_a_bad_effect_is_refused_with_the_valid_ones(values, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        SHORT.with_effects(values)


def test_a_rollout_with_every_effect_is_repeatable():
    worn = SHORT.with_effects({effect.name: between(effect, 0.1) for effect in SHORT.effects()})
    first = worn.rollout({"vd": 0.3}, 2)
    SHORT.rollout({"vd": -0.2}, 3)
    worn.rollout({"vd": -0.2}, 3)
    assert same(first, worn.rollout({"vd": 0.3}, 2))


def test_payload_is_carried_by_the_feet():
    trace = QUIET.with_effects({"payload": {"mass": 4.0}}).rollout({}, 0)
    force = trace["foot_force"][steady(trace), 2::3].sum(axis=1).mean()
    assert force == pytest.approx((A1.mass + 4.0) * 9.81, rel=0.02)


def test_a_payload_that_lies_higher_is_a_higher_centre_of_mass():
    trunk = A1.trunk.mass
    high = Physics().with_payload(2.0, z=0.18)
    low = Physics().with_payload(2.0)
    masses = [A1.loaded(p.payloads, p.com_shift).base for p in (high, low)]
    assert masses[0].mass == masses[1].mass > trunk
    assert masses[0].com[2] - masses[1].com[2] == pytest.approx(0.1 * 2.0 / masses[0].mass)


def test_weak_motors_let_the_body_sag():
    weak = QUIET.with_effects({"motor_strength": {"factor": 0.8}}).rollout({}, 0)
    strong = unchanged()
    sag = strong["height"][steady(strong)].mean() - weak["height"][steady(weak)].mean()
    assert 0.002 < sag < 0.02


def test_a_wrong_torque_constant_does_not_show_in_the_reported_torque():
    weak = QUIET.with_effects({"motor_strength": {"factor": 0.8}}).rollout({"vd": 0.3}, 0)
    wrong = QUIET.with_effects({"torque_constant": {"factor": 0.8}}).rollout({"vd": 0.3}, 0)
    np.testing.assert_allclose(wrong["q"], weak["q"], atol=1e-9)
    np.testing.assert_allclose(0.8 * wrong["tau"], weak["tau"], atol=1e-9)


def test_the_usual_load_is_that_of_an_unhurried_trot():
    trace = unchanged(0.0)
    assert (trace["tau"][steady(trace)] ** 2).sum(axis=1).mean() == pytest.approx(USUAL_LOAD, rel=0.1)


def test_strength_decays_from_the_command_on():
    fading = QUIET.with_effects({"strength_decay": {"rate": 0.2}}).rollout({}, 0)
    steady_one = unchanged()
    assert fading["height"][0] == steady_one["height"][0]
    assert fading["height"][-1] < steady_one["height"][-1] - 0.004


@pytest.mark.parametrize("delay", [0.0, 0.005, 0.012])
def test_a_command_moves_the_robot_after_the_delay_and_not_before(delay):
    late = SimBackend(duration=0.04, noise=Noise.off(), settings=SHORT_WARM_UP).with_effects(
        {"latency": {"delay": delay}}
    )
    stays, goes = (late.rollout({"vd": vd}, 0) for vd in (0.0, 0.3))
    assert not np.array_equal(stays["tau_cmd"][0], goes["tau_cmd"][0])
    apart = (stays["q"] != goes["q"]).any(axis=1)
    moved = stays.times[np.argmax(apart)]
    assert delay < moved <= delay + 0.002 + 1e-9


def test_uphill_the_robot_climbs_and_is_slower():
    trace = QUIET.with_effects({"slope": {"angle": 4.0}}).rollout({"vd": 0.3}, 0)
    rise = (trace["z"][-1] - trace["z"][0]) / (trace["x"][-1] - trace["x"][0])
    assert rise == pytest.approx(np.tan(np.radians(4.0)), rel=0.1)
    assert trace["vx"][steady(trace)].mean() < unchanged(0.3)["vx"][-400:].mean() - 0.02


def test_soft_ground_gives_way():
    soft = QUIET.with_effects({"soft_ground": {"sink": 0.02}}).rollout({}, 0)
    lowest = soft["foot_position"][:, 2::3].min()
    assert A1.foot_radius - 0.04 < lowest < unchanged()["foot_position"][:, 2::3].min() - 0.004


def test_drag_slows_the_robot_both_ways():
    grass = QUIET.with_effects({"foot_drag": {"coefficient": 12.0}})
    for vd in (-0.2, 0.3):
        slow, free = (trace["vx"][-400:].mean() for trace in (grass.rollout({"vd": vd}, 0), unchanged(vd)))
        assert abs(slow) < abs(free) - 0.01


def test_a_biased_estimate_shifts_the_true_velocity_by_most_of_it():
    # Not by all of it: on two point feet the QP trades forward acceleration for attitude.
    biased = QUIET.with_effects({"velocity_bias": {"forward": 0.05}}).rollout({}, 0)
    shift = biased["vx"][steady(biased)].mean() - unchanged()["vx"][-400:].mean()
    assert -0.05 < shift < -0.025


def test_a_biased_imu_makes_the_trunk_lean_the_other_way():
    seen = SimBackend("record=truth", duration=1.6, noise=Noise.off(), settings=SHORT_WARM_UP)
    tilted, level = (seen.with_effects(e).rollout({}, 0) for e in ({"attitude_bias": {"pitch": 3.0}}, {}))
    lean, said = (
        np.degrees(tilted[name][steady(tilted)].mean() - level["pitch"][-400:].mean())
        for name in ("pitch_true", "pitch")
    )
    assert -3.0 < lean < -1.0
    assert said == pytest.approx(lean + 3.0, abs=1e-6)


def test_where_on_uneven_ground_a_rollout_begins_comes_from_its_seed():
    rough = QUIET.with_duration(0.4).with_effects({"roughness": {"height": 0.005}})
    a, b = (rough.rollout({}, seed)["z"] for seed in (1, 2))
    assert np.abs(a - b).max() > 1e-4
    worlds = with_effects(Physics(), choose("sim", CATALOGUE.values(), (), {"roughness": {"height": 0.005}}))
    assert worlds.roughness == 0.005
