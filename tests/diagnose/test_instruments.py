"""Instruments: the nominal simulator's own motion, for equations of motion in a closed loop."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_emps import EmpsBackend
from s2r_emps.noise import Noise
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.axes import line
from s2r_spec.diagnose.equations import Equations, Instruments, Motion, Probe
from s2r_spec.diagnose.features import Features
from s2r_spec.diagnose.prepare import bench_of
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.trace import Trace

MOVE = {"speed": 0.1, "accel": 1.0, "payload": 0.0}
PROBES = (Probe("mass", "extra", 12.0, 1.0), Probe("motor_gain", "factor", 1.1, 1.0))
EQUATIONS = Equations(EmpsBackend(), PROBES, {"force": np.array([1.0])})


def moved(backend, times):
    return [backend.rollout(MOVE, seed) for seed in range(times)]


def asked(machine, instruments):
    return np.mean([EQUATIONS.regressed(trace, MOVE, instruments) for trace in moved(machine, 6)], axis=0)


@pytest.fixture(scope="module")
def instruments():
    return EQUATIONS.instruments([EmpsBackend().rollout(MOVE, seed) for seed in (100, 101, 102)], MOVE)


def test_a_disturbance_is_taken_for_less_of_everything_without_instruments_and_not_with_them(instruments):
    # Without mass and without gain there would be no residual at all.
    pushed = EmpsBackend(noise=replace(Noise(), disturbance=3.0))
    without, with_them = asked(pushed, None), asked(pushed, instruments)
    assert np.all(without < -2.0)
    assert np.all(np.abs(with_them) < 0.2 * np.abs(without))


def test_with_instruments_an_effect_that_is_there_is_asked_for():
    heavier = EmpsBackend().with_effects({"mass": {"extra": 12.0}})
    alone = Equations(EmpsBackend(), PROBES[:1], {"force": np.array([1.0])})
    by = alone.instruments([EmpsBackend().rollout(MOVE, 100)], MOVE)
    found = np.mean([alone.regressed(trace, MOVE, by)[0] for trace in moved(heavier, 6)])
    assert found == pytest.approx(1.0, abs=0.1)


def test_what_instruments_hold_of_a_regressor_says_how_strong_they_are(instruments):
    whole, held = EQUATIONS.strength(EmpsBackend().rollout(MOVE, 0), MOVE, instruments)
    assert np.all(held > 0.95 * whole)
    assert np.all(held <= whole)
    rng = np.random.default_rng(0)
    noise = replace(instruments, taken=tuple(rng.normal(size=x.shape) for x in instruments.taken))
    whole, held = EQUATIONS.strength(EmpsBackend().rollout(MOVE, 0), MOVE, noise)
    assert np.all(held < 0.05 * whole)


def test_instruments_are_read_at_the_times_of_the_recording(instruments):
    assert instruments.at(instruments.times) is instruments.taken
    between = 0.5 * (instruments.times[:-1] + instruments.times[1:])
    found = instruments.at(np.append(between, instruments.times[-1] + 1.0))[0]
    middle = 0.5 * (instruments.taken[0][:, :-1] + instruments.taken[0][:, 1:])
    np.testing.assert_allclose(found[:, :-1], middle)
    assert np.isnan(found[:, -1]).all()  # after the simulator's rollout there is none


def test_a_recording_that_goes_on_longer_is_asked_as_far_as_the_instruments_go(instruments):
    long = EmpsBackend(duration=4.0).rollout(MOVE, 0)
    short = EmpsBackend().rollout(MOVE, 0)
    np.testing.assert_allclose(
        EQUATIONS.regressed(long, MOVE, instruments),
        EQUATIONS.regressed(short, MOVE, instruments),
        atol=0.05,
    )


def test_nominal_rollouts_that_end_or_are_sampled_otherwise_count_where_they_are():
    whole, other = EmpsBackend().rollout(MOVE, 100), EmpsBackend().rollout(MOVE, 101)
    both = EQUATIONS.instruments([whole, other], MOVE)
    short = Trace(other.times[:1500], {n: x[:1500] for n, x in other.channels.items()}, other.units)
    found = EQUATIONS.instruments([whole, short], MOVE)
    there = np.isfinite(found.taken[0]).all(axis=(0, 2))
    assert 1300 < there.sum() < 1500
    inner = slice(100, 1200)  # the residuals' filter sees the end from farther away
    np.testing.assert_allclose(found.taken[0][:, inner], both.taken[0][:, inner], atol=0.02)
    assert np.isfinite(found.weight).all()


def test_where_no_instrument_can_be_made_there_is_none():
    bare = Trace(np.arange(400) / 1000, {"q": np.zeros(400)}, {"q": "m"})
    assert EQUATIONS.instruments([bare], MOVE) is None


@pytest.fixture(scope="module")
def bench():
    spec = s2r.load_spec("specs/emps_tracking.stl")
    found = bench_of(spec, spec.requirements[0], EmpsBackend())
    traces = [found.seen(found.run({}, MOVE, seed), MOVE) for seed in range(2)]
    features = Features.of_nominal(traces, found.backend.duration)
    return replace(found, features=replace(features, probes=PROBES, instrumented=True))


def test_instruments_of_a_test_are_made_once_and_not_sent_to_workers(bench):
    before = pickle.dumps(bench)
    first = bench.instruments(MOVE)
    assert first is not None
    assert bench.instruments(dict(reversed(MOVE.items()))) is first
    assert pickle.dumps(bench) == before
    assert replace(bench, features=replace(bench.features, instrumented=False)).instruments(MOVE) is None


def test_the_features_of_a_rollout_are_asked_with_instruments(bench):
    trace = EmpsBackend(noise=replace(Noise(), disturbance=3.0)).rollout(MOVE, 1)
    ours = bench.features.asked(bench.backend)
    by, bare = ours.regressed(trace, MOVE, bench.instruments(MOVE)), ours.regressed(trace, MOVE)
    row = bench.measure(trace, MOVE)
    np.testing.assert_array_equal(row[-len(PROBES) :], by)
    assert np.all(np.abs(by) < np.abs(bare))
    left = bench.unexplained(trace, MOVE)
    assert left == ours.unexplained(trace, MOVE, bench.instruments(MOVE)) > ours.unexplained(trace, MOVE)
    weights = bench.weights([MOVE, MOVE | {"payload": 20.0}])
    assert weights.shape == (2, 2, 2)
    assert not np.allclose(*weights)


def test_other_features_have_other_instruments(bench):
    loud = replace(bench, features=replace(bench.features, scale=2.0 * bench.features.scale))
    ratio = bench.instruments(MOVE).taken[0] / loud.instruments(MOVE).taken[0]
    np.testing.assert_allclose(ratio, 2.0)


class Shaken(EmpsBackend):
    """An axis whose every run follows a reference of its own: nominal runs say nothing of each other."""

    def rollout(self, params, seed):
        other = params | {"speed": 0.05 + 0.02 * (seed % 8), "accel": 0.5 + 0.2 * (seed % 7)}
        return super().rollout(other, seed)


@pytest.mark.parametrize(("kind", "strong"), [(EmpsBackend, True), (Shaken, False)])
def test_weak_instruments_are_not_used(bench, kind, strong):
    ours: Bench = replace(bench, backend=kind())
    assert banks._instrumented(ours, bench.features, (MOVE, MOVE | {"speed": 0.2})) is strong


def test_a_model_whose_mass_differs_between_tests_is_left_in_parts_of_its_motor_gain_alone(bench):
    catalogue = {effect.name: effect for effect in EmpsBackend().effects()}
    chosen = [catalogue[name] for name in ("viscous", "coulomb", "mass", "motor_gain")]
    found = tuple(line(effect, effect.parameters[0]) for effect in chosen)

    def voids(*tests):
        return banks._voids(bench, bench.features, found, [MOVE | test for test in tests], None)

    # at 1.1 times the gain its coordinate is 1: no gain at all is -10
    several = voids({}, {"payload": 10.0}, {"payload": 20.0})
    assert several == {"force": pytest.approx([0.0, -0.1], abs=1e-3)}
    # at one payload no mass says as well that nothing is left
    mass, gain = voids({}, {"speed": 0.15}, {"speed": 0.2})["force"]
    assert -0.1 < gain < -0.01
    assert mass < -0.01


def burst(own):
    """Return (2,) what is asked of a motion whose second effect shows in a tenth of the time, and in no nominal one."""
    rng = np.random.default_rng(3)
    times = np.arange(400) / 1000
    clean, (noise, other) = np.sin(40 * times), rng.normal(size=(2, 400))
    late = np.where((times > 0.2) & (times < 0.24), 1.0 + other, 0.0)
    taken = np.array([clean + 0.3 * noise, late])[:, :, np.newaxis]
    rest = (1.0 * clean + 2.0 * late)[:, np.newaxis]
    by = Instruments(times, (np.array([clean, np.zeros(400)])[:, :, np.newaxis],), np.array([False, own]))
    found, _ = Motion(times, (10.0 * rest,), (10.0 * taken,)).asked(by)
    return found


def test_what_shows_in_no_nominal_motion_is_asked_with_its_own_regressor():
    assert burst(own=True) == pytest.approx([1.0, 2.0], abs=0.1)
    assert abs(burst(own=False)[1]) < 0.2


def test_of_what_a_simulator_has_no_nominal_motion_of_it_has_no_instruments():
    idle = replace(PROBES[1], idle=True)
    equations = replace(EQUATIONS, probes=(PROBES[0], idle))
    found = equations.instruments([EmpsBackend().rollout(MOVE, 100)], MOVE)
    assert found.none.tolist() == [False, True]
