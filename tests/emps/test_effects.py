"""Effects of the axis: they compose in any order, do nothing at nominal, and do their physics otherwise."""

import random
from dataclasses import replace

import numpy as np
import pytest

from s2r_emps import EmpsBackend
from s2r_emps.axis import DriveCommand, simulate
from s2r_emps.effects import CATALOGUE
from s2r_emps.noise import Noise, draw
from s2r_emps.physics import STEP, Physics
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.trace import Trace
from tests.errors import naming

AXIS = EmpsBackend(duration=1.0)
QUIET = EmpsBackend(noise=Noise.off())
HARD = {"speed": 0.24, "accel": 2.0, "payload": 30.0}
"""A test in which every effect shows; the drive needs 6.9 V."""


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


def test_the_backend_offers_the_catalogue():
    assert len(AXIS.effects()) == 17
    for effect in AXIS.effects():
        assert CATALOGUE[effect.name] is effect
        assert effect.physics.endswith(".")
        for p in effect.parameters:
            assert p.low <= p.nominal <= p.high
            assert p.prior


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=lambda effect: effect.name)
def test_at_nominal_the_axis_is_unchanged(effect):
    assert effect.apply(Physics(), **nominal(effect)) == Physics()


def test_all_effects_at_nominal_change_no_bit():
    added = AXIS.with_effects({effect.name: nominal(effect) for effect in AXIS.effects()})
    assert same(AXIS.rollout(HARD, 4), added.rollout(HARD, 4))
    assert added.model_hash == AXIS.model_hash


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=lambda effect: effect.name)
def test_every_effect_changes_the_trace_and_the_hash(effect):
    added = AXIS.with_effects({effect.name: between(effect, 0.9)})
    assert added.model_hash != AXIS.model_hash
    assert not same(AXIS.rollout(HARD, 4), added.rollout(HARD, 4))


@pytest.mark.parametrize("seed", range(5))
def test_effects_applied_in_any_order_make_the_same_axis(seed):
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


def test_adding_one_by_one_is_adding_at_once_and_is_in_name_and_meta():
    one = AXIS.with_effects({"delay": {"time": 0.002}}).with_effects({"coulomb": {"force": 20}})
    both = AXIS.with_effects({"coulomb": {"force": 20.0}, "delay": {"time": 0.002}})
    assert one == both
    assert one.name == "emps:coulomb.force=20.0,delay.time=0.002"
    assert EmpsBackend(one.name.removeprefix("emps:"), duration=1.0) == one
    assert one.rollout({}, 0).meta["effects"] == {"coulomb": {"force": 20.0}, "delay": {"time": 0.002}}


@pytest.mark.parametrize(
    ("options", "facts"),
    [
        ("coulomb.force=much", ["'coulomb.force=much'"]),
        (
            "coulom.force=1",
            ["'emps'", "'coulom'", "did you mean 'coulomb'", "backlash"],
        ),
        ("coulomb.torque=1", ["'coulomb'", "'torque'", "force"]),
        ("coulomb.force=100", ["coulomb", "force = 100 N", "[0, 80] N"]),
        ("motor_gain.factor=nan", ["motor_gain", "factor = nan"]),
        (
            "refrence=a.mat",
            ["'refrence'", "did you mean 'reference'"],
        ),
    ],
)
def test_a_bad_option_is_refused_with_the_valid_ones(options, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        EmpsBackend(options)


EXPLAINED = {
    "viscous": {"coefficient": 300.0, "direction": 0.4},
    "coulomb": {"force": 30.0},
    "quadratic_drag": {"coefficient": 1500.0},
    "load_friction": {"coefficient": 0.2},
    "offset": {"force": 20.0},
    "cable": {"stiffness": 400.0},
    "force_ripple": {"amplitude": 20.0, "phase": 1.0},
    "motor_gain": {"factor": 0.85},
    "current_lag": {"time": 0.003},
    "supply_sag": {"drop": 0.3},
    "delay": {"time": 0.0025},
    "mass": {"extra": 20.0},
}


@pytest.mark.parametrize("name", EXPLAINED)
def test_the_residual_force_vanishes_in_the_right_model_and_in_no_other(name):
    """Independent of the simulator's ticks: inverse dynamics by filters and derivatives."""
    worn = QUIET.with_effects({name: EXPLAINED[name]})
    trace = worn.rollout(HARD, 0)
    left = worn.residuals(trace, HARD)["force"]
    before = QUIET.residuals(trace, HARD)["force"]
    assert np.sqrt(np.mean(left**2)) < 0.06 * np.sqrt(np.mean(before**2))
    assert np.sqrt(np.mean(left**2)) < 0.7


def test_the_residuals_of_the_nominal_axis_are_its_noise():
    left = EmpsBackend().residuals(EmpsBackend().rollout(HARD, 0), HARD)
    assert dict(left.units) == {"force": "N", "controller": "V"}
    assert left.meta["parts"] == {"force": ["carriage"], "controller": ["controller"]}
    assert 0.5 < left["force"].std() < 2.5  # a disturbance of 1 N, and a payload that is not quite 30 kg
    assert np.abs(left["controller"]).max() < 1e-6


def test_a_voltage_that_the_controller_did_not_ask_for_is_a_residual_of_the_controller():
    trace = QUIET.rollout({}, 0)
    pulse = 5.0 * ((trace.times > 1.0) & (trace.times < 1.5))
    logged = Trace(trace.times, {**trace.channels, "u": trace["u"] + pulse}, trace.units)
    left = QUIET.residuals(logged)
    np.testing.assert_allclose(left["controller"], pulse[50:-50], atol=1e-6)


def test_residuals_say_what_they_need():
    trace = QUIET.rollout({}, 0)
    assert "controller" not in QUIET.residuals(trace.only(["q", "u"])).channels
    with pytest.raises(TraceError, match=naming("q", "u", "q, q_ref")):
        QUIET.residuals(trace.only(["q", "q_ref"]))
    with pytest.raises(TraceError, match=naming("150 samples", "1 ms")):
        QUIET.with_duration(0.1).residuals(QUIET.with_duration(0.1).rollout({}, 0))


def test_dry_friction_holds_the_carriage_where_it_is():
    stuck = QUIET.with_effects({"coulomb": {"force": 80.0}})
    trace = stuck.rollout({"stroke": 2e-5, "pause": 2.0}, 0)
    assert np.ptp(trace["q"]) == 0.0  # 20 µm ask for 27 N


def test_breaking_loose_takes_more_than_sliding():
    sticky = QUIET.with_effects({"stribeck": {"force": 40.0}})
    trace = sticky.rollout({"speed": 0.1, "accel": 0.5}, 0)
    loose = np.argmax(trace["q"] != trace["q"][0])
    assert trace["force"][loose - 2] <= 40.0 <= trace["force"][loose]
    cruising = (trace.times > 0.6) & (trace.times < 1.0)
    assert np.abs(trace["force"][cruising]).max() < 1.0


def test_a_heavier_carriage_and_a_weaker_motor_are_told_apart_by_a_payload():
    heavy = QUIET.with_effects({"mass": {"extra": 95.0 / 9}})
    weak = QUIET.with_effects({"motor_gain": {"factor": 0.9}})
    apart = [
        np.abs(heavy.rollout({"payload": kg}, 0)["u"] - weak.rollout({"payload": kg}, 0)["u"]).max()
        for kg in (0.0, 40.0)
    ]
    assert apart[0] < 1e-8
    assert apart[1] > 0.05


def test_play_that_vanishes_is_no_play():
    tiny = QUIET.with_effects({"backlash": {"half_gap": 1e-12}}).rollout(HARD, 0)
    none = QUIET.rollout(HARD, 0)
    assert np.abs(tiny["q"] - none["q"]).max() < 1e-9
    assert np.abs(tiny["u"] - none["u"]).max() < 1e-3


def test_within_its_play_the_motor_moves_nothing_but_itself():
    trace = QUIET.with_effects({"backlash": {"half_gap": 1e-4}}).rollout(HARD, 0)
    gone, force = trace["q"] - trace["q"][0], trace["force"]
    free = np.flatnonzero((gone > 1e-6) & (gone < 9e-5))
    free = free[free < np.argmax(gone > 1e-4)]
    bent = (gone[free + 1] - 2 * gone[free] + gone[free - 1]) / 1e-6
    assert free.size > 5
    np.testing.assert_allclose(bent * 0.3 * (95.0 + 30.0), (force[free] + force[free - 1]) / 2, rtol=1e-6)


def test_a_speed_filter_is_in_the_controllers_law():
    slow = QUIET.with_effects({"speed_filter": {"time": 0.003}})
    trace = slow.rollout({}, 0)
    assert np.abs(slow.residuals(trace)["controller"]).max() < 1e-6
    assert np.abs(QUIET.residuals(trace)["controller"]).max() > 0.05


def test_a_lower_limit_saturates_the_drive():
    trace = QUIET.with_effects({"voltage_limit": {"voltage": 4.0}}).rollout(HARD, 0)
    assert np.abs(trace["u"]).max() == 4.0


def test_an_eccentric_encoder_reads_a_wave():
    trace = QUIET.with_effects({"encoder_ripple": {"amplitude": 5e-5}}).rollout(
        {"speed": 0.05, "accel": 2.0}, 0
    )
    cruising = (trace.times > 0.3) & (trace.times < 1.9)
    smooth = np.polynomial.Polynomial.fit(trace.times[cruising], trace["force"][cruising], 2)
    wave = trace["force"][cruising] - smooth(trace.times[cruising])
    spectrum = np.abs(np.fft.rfft(wave))
    frequency = np.fft.rfftfreq(wave.size, 1e-3)[spectrum.argmax()]
    assert frequency == pytest.approx(0.05 / 0.02, abs=0.7)


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.0024])
def test_no_voltage_reaches_the_axis_before_the_delay(delay):
    ticks = 30
    draws = draw(Noise.off(), 0, ticks)
    reference = np.full(ticks, 0.11)
    command = DriveCommand.following(reference, np.ones(ticks, dtype=bool))
    found = simulate(command, (0.1, 0.0), replace(Physics(), delay=delay), draws)
    moved = np.flatnonzero(np.abs(found.q - 0.1) > 1e-12)[0]
    assert found.u[0] > 1.0  # it is asked for at once
    # A voltage is held for a tick, and shows in the position at its end.
    assert moved == int(delay / STEP + 1e-9) + 1


@pytest.mark.parametrize("alone", [{"delay": {"jitter": 0.3}}, {"viscous": {"direction": 0.5}}])
def test_a_dependent_parameter_does_nothing_by_itself(alone):
    assert same(AXIS.rollout(HARD, 4), AXIS.with_effects(alone).rollout(HARD, 4))


def test_a_jitter_varies_the_delay_around_its_mean():
    """The voltage rises by 1 mV a tick, so the force of a tick says how old its command is."""
    ticks = 2000
    command = DriveCommand(np.zeros(ticks), np.zeros(ticks, dtype=bool), 1e-3 * np.arange(ticks))
    physics = replace(Physics(), delay=0.003, jitter=0.2)
    found = simulate(command, (0.1, 0.0), physics, draw(Noise.off(), 5, ticks))
    force = physics.mass * np.diff(found.q, 2) / STEP**2  # mean of two ticks
    age = np.arange(ticks - 2) + 0.5 - force / (1e-3 * physics.gain)
    assert age[10:].mean() == pytest.approx(3.0, abs=0.05)
    assert age[10:].std() == pytest.approx(0.6 / 2**0.5, rel=0.1)
    again = simulate(command, (0.1, 0.0), physics, draw(Noise.off(), 5, ticks))
    assert again.q.tobytes() == found.q.tobytes()
